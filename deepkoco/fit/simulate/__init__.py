"""The simulator of a fit: many parameter sets and windows in one batch."""
