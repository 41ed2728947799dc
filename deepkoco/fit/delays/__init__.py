"""Delays that nobody measured."""
