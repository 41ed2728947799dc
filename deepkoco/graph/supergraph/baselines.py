"""Baselines: supergraphs that hold every partition whatever its shape.

Source: thesis section 3.5; both take the vertices between two supervisor steps in one topological order of
the computation graph, that of the generations of `networkx.topological_generations`.
"""

import numpy as np
from numba import njit

from deepkoco.graph.supergraph.embedding import Supergraph, embed
from deepkoco.graph.supergraph.partition import Partitions


def generational(parts: Partitions) -> Supergraph:
    """Return as many generations of all kinds as the deepest partition has (`gen`)."""
    return _full(parts, _largest(parts)[1])


def topological(parts: Partitions) -> Supergraph:
    """Return as many generations of all kinds as the largest partition has vertices (`top`)."""
    return _full(parts, _largest(parts)[0])


def _full(parts: Partitions, generations: int) -> Supergraph:
    kinds = np.delete(np.arange(parts.kinds), parts.supervisor)
    while True:
        full = Supergraph(np.tile(kinds, generations), np.repeat(np.arange(generations), len(kinds)))
        if embed(parts, full) is not None:
            return full
        # Steps that nothing waits for, or that may not run as early as the order would have them.
        generations += 1


@njit(cache=True)
def _largest(parts):
    """Most vertices, and most generations, between two supervisor steps."""
    generation = np.zeros(len(parts.kind), np.int64)
    depth = np.zeros(len(parts.kind), np.int64)
    last = np.empty(parts.kinds, np.int64)
    most, deepest = 0, 0
    for e in range(len(parts.passes)):
        begin, end = parts.first[e], parts.first[e + 1]
        last[:] = -1
        for v in range(begin, end):
            k = parts.kind[v]
            if last[k] >= 0:
                generation[v] = generation[last[k]] + 1
            for i in range(parts.pred_base[v], parts.pred_base[v + 1]):
                generation[v] = max(generation[v], generation[parts.pred[i]] + 1)
            last[k] = v
        # In the order of (generation, kind): the vertices up to a supervisor step are a partition.
        order = begin + np.argsort(
            generation[begin:end] * parts.kinds + parts.kind[begin:end], kind="mergesort"
        )
        part = np.zeros(end - begin, np.int64)
        j = 0
        size = 0
        for v in order:
            part[v - begin] = j
            if parts.kind[v] == parts.supervisor:
                most = max(most, size)
                size = -1
                j += 1
            size += 1
        last[:] = -1
        for v in range(begin, end):
            k = parts.kind[v]
            depth[v] = 1
            if last[k] >= 0 and part[last[k] - begin] == part[v - begin]:
                depth[v] = depth[last[k]] + 1
            for i in range(parts.pred_base[v], parts.pred_base[v + 1]):
                p = parts.pred[i]
                if part[p - begin] == part[v - begin]:
                    depth[v] = max(depth[v], depth[p] + 1)
            last[k] = v
            if k != parts.supervisor and part[v - begin] < j:
                deepest = max(deepest, depth[v])
    return most, deepest
