"""Verdict on the selected causes, with findings and advice."""

from deepkoco.old_names import moved_names

__getattr__ = moved_names(__name__)
