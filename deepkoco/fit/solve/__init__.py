"""Solving a fit: methods, priors, nuisances and what the data cannot tell."""
