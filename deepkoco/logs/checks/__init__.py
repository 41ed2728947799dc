"""Checks of a log before it is used."""
