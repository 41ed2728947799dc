"""Commands that were sent and logged but never acted."""
