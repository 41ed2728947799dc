"""Estimate the present state of a system from delayed measurements."""
