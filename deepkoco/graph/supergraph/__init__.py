"""Supergraphs: one sequence of slots in which the steps of all environments run under masks."""

from deepkoco.graph.supergraph.embedding import Embedding, embed, grow
from deepkoco.graph.supergraph.merge import MergedSlots, join_slots, merge_slots
from deepkoco.graph.supergraph.partition import (
    GraphCycleError,
    Partitions,
    count_bound,
    partition_graphs,
    partition_timing,
    window_bound,
)
from deepkoco.graph.supergraph.search import find_slots

__all__ = [
    "Embedding",
    "GraphCycleError",
    "MergedSlots",
    "Partitions",
    "count_bound",
    "embed",
    "find_slots",
    "grow",
    "join_slots",
    "merge_slots",
    "partition_graphs",
    "partition_timing",
    "window_bound",
]
