"""Supergraphs: one sequence of slots in which the steps of all environments run under masks."""

from deepkoco.graph.supergraph.baselines import generational, topological
from deepkoco.graph.supergraph.bounds import count_bound, window_bound
from deepkoco.graph.supergraph.efficiency import Efficiency, efficiency_bound, measure, measure_sequential
from deepkoco.graph.supergraph.embedding import Embedding, Supergraph, embed, grow
from deepkoco.graph.supergraph.mcs import grow_common
from deepkoco.graph.supergraph.merge import MergedSlots, join_slots, merge_slots
from deepkoco.graph.supergraph.partition import (
    GraphCycleError,
    Partitions,
    partition_graphs,
    partition_timing,
)
from deepkoco.graph.supergraph.search import find_slots

__all__ = [
    "Efficiency",
    "Embedding",
    "GraphCycleError",
    "MergedSlots",
    "Partitions",
    "Supergraph",
    "count_bound",
    "efficiency_bound",
    "embed",
    "find_slots",
    "generational",
    "grow",
    "grow_common",
    "join_slots",
    "measure",
    "measure_sequential",
    "merge_slots",
    "partition_graphs",
    "partition_timing",
    "topological",
    "window_bound",
]
