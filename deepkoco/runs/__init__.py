"""Training runs: their settings, folders and commands (train, evaluate, sweep, aggregate)."""
