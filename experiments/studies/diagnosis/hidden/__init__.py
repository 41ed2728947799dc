"""Units with a hidden effect, independent of the simulator, and what a diagnosis of their logs is worth."""
