"""Studies of the delay graph."""
