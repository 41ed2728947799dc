"""Prepare recordings for a fit: windows, sensor noise, and known differences of the logs."""
