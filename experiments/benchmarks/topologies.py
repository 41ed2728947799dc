"""Computation graphs of the supergraph evaluation: who talks to whom, at which rates, with which delays.

Vehicles in a platoon (`v2v`), a swarm of unmanned aerial vehicles (`uav`) and three rings. The draws, the
rounding to single precision and the rule by which a message finds its receiver follow the generator of the
peer package `supergraph` 0.0.8 to the bit, so that the same seed gives the same graphs there and here.

Source: delay process of thesis section 3.5, x_k = (1 - theta) x_{k-1} + sigma nu_k with theta = 0.07, periods
(1/f) max(1, 1 + x_k); topologies as in the peer's `scripts/generate_graphs.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from deepkoco.graph.supergraph.partition import Partitions, partition_graphs

THETA = 0.07
SUPERVISOR = 0
FAST = 200.0  # rate of the last node, the simulator [Hz]
TOPOLOGIES = ("v2v", "uav", "unidirectional", "bidirectional", "unirandom")


@dataclass(frozen=True)
class Topology:
    """Rates [Hz] of the nodes and (sender, receiver) pairs; every node also depends on its own last step.

    With `every` a step depends on all messages that have come since the last one, else on the latest.
    """

    name: str
    rates: tuple[float, ...]
    edges: tuple[tuple[int, int], ...]
    every: bool


class Episode(NamedTuple):
    """One computation graph: what the last supervisor step depends on.

    Attributes:
        kind, seq: (V,) node and step of each vertex, in the order of their times.
        time: (V,) float32 [s].
        edges: (n, 2) vertices, sender and receiver, those of successive steps of a node included; by receiver.
    """

    kind: np.ndarray
    seq: np.ndarray
    time: np.ndarray
    edges: np.ndarray


def make_topology(name: str, nodes: int, generator: np.random.Generator) -> Topology:
    """Connect `nodes` nodes; the generator is used by "unirandom" alone.

    Raises:
        ValueError: no such topology, or fewer than 2 nodes.
    """
    if name not in TOPOLOGIES:
        raise ValueError(f'topology "{name}" is none of {", ".join(TOPOLOGIES)}')
    if nodes < 2:
        raise ValueError(f"{nodes} nodes: a topology has at least 2")
    last = nodes - 1
    edges: set[tuple[int, int]] = set()
    if name in ("v2v", "uav"):
        rates = (20.0,) * last + (FAST,)
        for i in range(last):
            edges |= {(last, i), (i, last)}
        for i in range(1, last):
            edges.add((0, i))
            if name == "uav":
                edges.add((i, 0))
            elif i + 1 < last:
                edges.add((i, i + 1))
        return Topology(name, rates, tuple(sorted(edges)), every=False)
    rates = (*map(float, range(1, nodes)), FAST)
    edges = {(i, (i + 1) % nodes) for i in range(nodes)}
    if name == "bidirectional":
        edges |= {(b, a) for a, b in edges}
    elif name == "unirandom" and nodes > 2:
        for i in range(nodes):
            free = [k for k in range(nodes) if (i, k) not in edges and k != i]
            drawn = int(generator.integers(last))
            if drawn < len(free):  # the draw counts one candidate more than there is
                edges.add((i, free[drawn]))
    return Topology(name, rates, tuple(sorted(edges)), every=True)


def episode_seeds(seed: int, episodes: int) -> np.ndarray:
    """Seeds of the delays of each episode."""
    _, _, episode_seed = np.random.SeedSequence(seed).spawn(3)
    return np.random.default_rng(episode_seed).integers(0, np.iinfo(np.int32).max, size=episodes)


def generate(
    topology: str, nodes: int, sigma: float, seed: int, episodes: int, length: float
) -> tuple[Topology, list[Episode]]:
    """Draw the computation graphs of one cell of the evaluation.

    Args:
        topology: one of `TOPOLOGIES`.
        nodes: number of nodes N.
        sigma: noise of the delay process.
        seed: of topology and delays.
        episodes: number of graphs.
        length: duration that each node has ticks for [s].
    """
    _, topology_seed, _ = np.random.SeedSequence(seed).spawn(3)
    connected = make_topology(topology, nodes, np.random.default_rng(topology_seed))
    return connected, [_episode(connected, sigma, int(s), length) for s in episode_seeds(seed, episodes)]


def partition(topology: Topology, episodes: list[Episode]) -> Partitions:
    """Cut the graphs at the steps of the supervisor."""
    sizes = np.array([len(e.kind) for e in episodes])
    first = np.concatenate([[0], np.cumsum(sizes)])
    kind, seq = np.concatenate([e.kind for e in episodes]), np.concatenate([e.seq for e in episodes])
    sender = np.concatenate([e.edges[:, 0] + f for e, f in zip(episodes, first, strict=False)])
    receiver = np.concatenate([e.edges[:, 1] + f for e, f in zip(episodes, first, strict=False)])
    other = kind[sender] != kind[receiver]
    base = np.concatenate([[0], np.cumsum(np.bincount(receiver[other], minlength=len(kind)))])
    return partition_graphs(len(topology.rates), SUPERVISOR, first, kind, seq, base, sender[other])


def _episode(topology: Topology, sigma: float, seed: int, length: float) -> Episode:
    generator = np.random.default_rng(seed)
    times = []
    for rate in topology.rates:
        count = math.ceil(length * rate)
        # The first value of the process is 0; it takes no draw.
        x = _process(THETA, sigma, generator.normal(0.0, 1.0, size=count - 1), count)
        period = np.maximum((np.float32(1) + x) / np.float32(rate), np.float32(1 / rate))
        times.append(np.concatenate([np.zeros(1, np.float32), np.cumsum(period, dtype=np.float32)]))
    end = min(t[-1] for t in times)
    times = [t[t < end] for t in times]
    base = np.concatenate([[0], np.cumsum([len(t) for t in times])])
    pairs = []
    for kind, t in enumerate(times):
        steps = np.arange(base[kind], base[kind] + len(t))
        pairs.append(np.stack([steps[:-1], steps[1:]], axis=1))
    for a, b in topology.edges:
        arrival = times[a].astype(np.float64) + 1 / topology.rates[a]
        tick = np.searchsorted(times[b].astype(np.float64), arrival, side="left" if a < b else "right")
        seen = tick < len(times[b])
        if not topology.every:
            seen &= tick != np.append(tick[1:], -1)  # of several messages for one tick the last
        seen = np.flatnonzero(seen)
        pairs.append(np.stack([base[a] + seen, base[b] + tick[seen]], axis=1))
    kind = np.repeat(np.arange(len(times)), np.diff(base))
    seq = np.arange(base[-1]) - base[kind]
    time = np.concatenate(times)
    order = np.lexsort((kind, time))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    edges = place[np.concatenate(pairs)]
    last = int(place[base[SUPERVISOR + 1] - 1])
    edges = edges[np.argsort(edges[:, 1], kind="stable")]
    kept = _ancestors(edges, last, len(order))
    number = np.cumsum(kept) - 1
    edges = number[edges[kept[edges[:, 1]]]]
    return Episode(kind[order][kept], seq[order][kept], time[order][kept], edges)


@njit(cache=True)
def _process(theta, sigma, noise, count):
    x = np.zeros(count, np.float32)
    for i in range(1, count):
        x[i] = x[i - 1] + theta * (0.0 - x[i - 1]) + sigma * noise[i - 1]
    return x


@njit(cache=True)
def _ancestors(edges, last, count):
    """Mark what vertex `last` depends on; edges (n, 2) are sorted by their receiver."""
    kept = np.zeros(count, np.bool_)
    kept[last] = True
    for i in range(len(edges) - 1, -1, -1):
        if kept[edges[i, 1]]:
            kept[edges[i, 0]] = True
    return kept
