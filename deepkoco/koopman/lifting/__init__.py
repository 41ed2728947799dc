"""Models that are linear in a lifted observation."""
