"""Verdict on the selected causes, with findings and advice."""
