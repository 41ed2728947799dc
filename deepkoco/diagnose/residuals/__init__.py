"""Residuals of a fit: missing load, whiteness, spectrum, signatures and noise tests."""
