"""Studies of diagnosis and identification."""
