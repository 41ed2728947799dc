"""Efficiency: how much of what a supergraph can run is work."""

from typing import NamedTuple

import numpy as np
from numba import njit

from deepkoco.graph.supergraph.bounds import count_bound, window_bound
from deepkoco.graph.supergraph.embedding import Supergraph, embed
from deepkoco.graph.supergraph.partition import Partitions


class Efficiency(NamedTuple):
    """What embedding all episodes in a supergraph costs.

    Attributes:
        size: slots |S|, that of the supervisor included.
        passes: passes of all episodes; one for each step of the supervisor.
        work: vertices that ran.
        efficiency: work / (size * passes).
        utilisation: (size,) part of the passes in which each slot runs, the supervisor's last.
    """

    size: int
    passes: int
    work: int
    efficiency: float
    utilisation: np.ndarray


def measure(parts: Partitions, supergraph: Supergraph) -> Efficiency:
    """Embed all episodes and count.

    Raises:
        ValueError: an episode does not fit.
    """
    found = embed(parts, supergraph)
    if found is None:
        raise ValueError(f"an episode does not fit in these {supergraph.size} slots")
    passes = int(parts.passes.sum())
    behind = int(supergraph.generation[-1]) + 1 if len(supergraph.generation) else 0
    used = np.bincount(
        found.generation * parts.kinds + parts.kind, minlength=(behind + 1) * parts.kinds
    ).reshape(-1, parts.kinds)
    slots = np.append(used[supergraph.generation, supergraph.kind], used[behind, parts.supervisor])
    return Efficiency(
        supergraph.size, passes, parts.work, parts.work / (supergraph.size * passes), slots / passes
    )


def efficiency_bound(parts: Partitions, releases: bool = False) -> float:
    """Return what no supergraph with one supervisor step per pass can exceed.

    Args:
        parts: the episodes.
        releases: also use that steps cannot run before the supervisor steps that they depend on.
    """
    bound = window_bound(parts) if releases else count_bound(parts)
    return parts.work / (float(bound.sum()) * float(parts.passes.sum()))


def measure_sequential(parts: Partitions) -> Efficiency:
    """Measure the smallest supergraph there is, one slot of each kind, in the order of the kinds.

    Its passes do not end with a step of the supervisor: they go on until everything has run.
    """
    passes = int(_count_free_passes(parts).sum())
    share = np.bincount(parts.kind, minlength=parts.kinds) / passes
    return Efficiency(parts.kinds, passes, parts.work, parts.work / (parts.kinds * passes), share)


@njit(cache=True)
def _count_free_passes(parts):
    needed = np.zeros(len(parts.passes), np.int64)
    turn = np.empty(len(parts.kind), np.int64)
    last = np.empty(parts.kinds, np.int64)
    for e in range(len(parts.passes)):
        last[:] = -1
        for v in range(parts.first[e], parts.first[e + 1]):
            k = parts.kind[v]
            turn[v] = last[k] + 1
            for i in range(parts.pred_base[v], parts.pred_base[v + 1]):
                p = parts.pred[i]
                turn[v] = max(turn[v], turn[p] + (parts.kind[p] > k))
            last[k] = turn[v]
            needed[e] = max(needed[e], turn[v] + 1)
    return needed
