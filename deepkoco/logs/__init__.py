"""Logs of real or simulated units: read, checked and inspected."""
