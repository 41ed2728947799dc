"""Units with a hidden effect, written without the simulator's code: the independent side of every diagnosis test."""
