"""Benchmarks: what things cost, against the named peer in the same run."""
