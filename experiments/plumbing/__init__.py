"""What studies and benchmarks share: rows that survive a kill, and where a result comes from."""
