"""Simulator of a fit: many sets of parameters and windows in one batch."""
