"""Subcommands of `deepkoco` for recordings of graphs; the work is done in `deepkoco.graph`."""
