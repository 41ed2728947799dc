"""Supergraphs: one sequence of slots in which the steps of all environments run under masks."""

from deepkoco.graph.supergraph.merge import MergedSlots, merge_slots

__all__ = ["MergedSlots", "merge_slots"]
