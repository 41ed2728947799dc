"""Estimate delays that are not measured."""
