"""Solve a fit: methods, priors, nuisances and identifiability."""
