"""Agents on one harness: learning curves, final costs and sample efficiency from folders of runs."""
