"""Partitions: computation graphs cut at the supervisor's steps, with the passes in which each step may run.

A pass is one run through the slots of a supergraph; it ends with the supervisor's step. Pass j therefore runs
everything that supervisor step j depends on and no earlier pass has run.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numba import njit

from deepkoco.graph.timing.computation_graph import ComputationGraph

AHEAD = 1


class GraphCycleError(RuntimeError):
    """A computation graph has a cycle: a step needs a message that depends on the step itself."""


class Partitions(NamedTuple):
    """Steps (vertices) of several episodes, sorted by the pass in which they are needed.

    Vertices of an episode lie side by side; within it those with an earlier deadline come first, senders
    before receivers, and the supervisor's step last among those it needs. Every vertex depends on the one
    before of its kind and on those whose messages it uses.

    Attributes:
        kinds: number of nodes N of the graph; a vertex is of the kind of its node.
        supervisor: kind of the supervisor.
        first: (E + 1,) first vertex of each episode.
        passes: (E,) supervisor steps of each episode.
        kind, seq: (V,) node and step of each vertex.
        release: (V,) first pass in which it can run: after all supervisor steps that it depends on.
        deadline: (V,) last pass in which it can run: that of the first supervisor step that depends on it, or
            the last pass of the episode.
        pred_base, pred: (V + 1,), (P,) vertices that a vertex depends on, without that of its own kind.
    """

    kinds: int
    supervisor: int
    first: np.ndarray
    passes: np.ndarray
    kind: np.ndarray
    seq: np.ndarray
    release: np.ndarray
    deadline: np.ndarray
    pred_base: np.ndarray
    pred: np.ndarray

    @property
    def work(self) -> int:
        """Number of vertices: how many node steps every supergraph has to run."""
        return len(self.kind)


def partition_graphs(
    kinds: int,
    supervisor: int,
    first: np.ndarray,
    kind: np.ndarray,
    seq: np.ndarray,
    pred_base: np.ndarray,
    pred: np.ndarray,
    earliest: np.ndarray | None = None,
) -> Partitions:
    """Cut computation graphs at the supervisor's steps.

    Args:
        kinds: number of nodes.
        supervisor: kind of the supervisor; its last step ends an episode.
        first: (E + 1,) first vertex of each episode.
        kind, seq: (V,) node and step, those of one node in their order; best in the order of time.
        pred_base, pred: (V + 1,), (P,) vertices whose messages a vertex uses.
        earliest: (V,) pass before which a vertex must not run, whatever it depends on.

    Raises:
        GraphCycleError: the vertices have no order in which senders come before receivers.
        ValueError: an episode has no step of the supervisor.
    """
    first, pred_base = np.asarray(first, np.int64), np.asarray(pred_base, np.int64)
    kind, seq, pred = np.asarray(kind, np.int32), np.asarray(seq, np.int32), np.asarray(pred, np.int32)
    passes = np.array(
        [np.count_nonzero(kind[a:b] == supervisor) for a, b in pairwise(first)],
        dtype=np.int64,
    )
    if (passes == 0).any():
        raise ValueError(f"episode {int(np.argmin(passes))} has no step of the supervisor")
    earliest = np.zeros(len(kind), np.int32) if earliest is None else np.asarray(earliest, np.int32)
    place, order, release, deadline = _windows(
        kinds, supervisor, first, passes, kind, pred_base, pred, earliest
    )
    if len(place) == 0:
        raise GraphCycleError("a step needs a message that is sent later: the computation graph has a cycle")
    base, moved = _reorder(place, order, kind, pred_base, pred)
    return Partitions(
        kinds,
        supervisor,
        first,
        passes,
        kind[order],
        seq[order],
        release[order],
        deadline[order],
        base,
        moved,
    )


def partition_timing(timing: ComputationGraph) -> Partitions:
    """Cut the schedules of a timing.

    All steps that start before the last step of the supervisor run, that one only looks. No step runs more
    than `AHEAD` passes before the one it starts in: the outputs of a node that runs far ahead would all have to
    be kept until they are seen.

    Raises:
        GraphCycleError: a step needs a message that is sent later.
    """
    layout = timing.layout
    counts = timing.boundary[:, -1].astype(np.int64)
    counts[:, layout.supervisor] += 1
    first = np.concatenate([[0], np.cumsum(counts.sum(axis=1))])
    kind, seq, start, earliest = _steps(
        counts, first, layout.supervisor, layout.step_base, timing.t_start, timing.boundary
    )
    episode = np.repeat(np.arange(len(counts)), np.diff(first))
    order = np.lexsort((kind, start, episode))
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    kind, seq, earliest = kind[order], seq[order], earliest[order]
    pred_base, pred = _messages(
        counts,
        first,
        place,
        episode,
        kind,
        seq,
        layout.sender,
        layout.receiver,
        layout.window,
        layout.window_base,
        timing.windows,
    )
    return partition_graphs(
        len(layout.names), layout.supervisor, first, kind, seq, pred_base, pred, earliest=earliest
    )


@njit(cache=True)
def _steps(counts, first, supervisor, step_base, t_start, boundary):
    """List the steps of all rows by node: node, step, t_start and the first pass in which each may run."""
    total, passes = first[-1], boundary.shape[1]
    kind, seq = np.empty(total, np.int32), np.empty(total, np.int32)
    start, earliest = np.empty(total, np.int64), np.empty(total, np.int32)
    for row in range(len(counts)):
        v = first[row]
        for n in range(counts.shape[1]):
            j = 0
            for k in range(counts[row, n]):
                while j < passes - 1 and boundary[row, j, n] <= k:
                    j += 1
                kind[v], seq[v], start[v] = n, k, t_start[row, step_base[n] + k]
                earliest[v] = 0 if n == supervisor else max(0, j - AHEAD)
                v += 1
    return kind, seq, start, earliest


@njit(cache=True)
def _messages(counts, first, place, episode, kind, seq, sender, receiver, window, window_base, windows):
    """List whose messages each vertex uses; place: of the steps by node, among the vertices."""
    edges, total = len(sender), first[-1]
    begin = np.empty(counts.shape, np.int64)
    for row in range(len(counts)):
        v = first[row]
        for n in range(counts.shape[1]):
            begin[row, n] = v
            v += counts[row, n]
    base, pred = np.zeros(total + 1, np.int64), np.empty(max(1, total * edges), np.int32)
    size = 0
    for v in range(total):
        row = episode[v]
        for e in range(edges):
            if receiver[e] != kind[v] or sender[e] == kind[v]:
                continue
            # The sender's steps run in their order: the latest message seen stands for all.
            newest = np.int64(-1)
            for w in range(window[e]):
                newest = max(newest, np.int64(windows[row, window_base[e] + seq[v] * window[e] + w]))
            if newest >= 0:
                pred[size] = place[begin[row, sender[e]] + newest]
                size += 1
        base[v + 1] = size
    return base, pred[:size].copy()


@njit(cache=True)
def _windows(kinds, supervisor, first, passes, kind, pred_base, pred, earliest):
    """Sort topologically and work out release and deadline; no places at all where there is a cycle."""
    total = first[-1]
    release, deadline = np.zeros(total, np.int32), np.zeros(total, np.int32)
    own = np.full(total, -1, np.int32)  # the vertex before of the same kind
    last = np.full(kinds, -1, np.int32)
    for e in range(len(passes)):
        last[:] = -1
        for v in range(first[e], first[e + 1]):
            own[v] = last[kind[v]]
            last[kind[v]] = v
        deadline[first[e] : first[e + 1]] = passes[e] - 1
    queue = _topological(own, pred_base, pred)
    if len(queue) < total:
        return np.empty(0, np.int32), queue, release, deadline
    for v in queue:
        release[v] = earliest[v]
        if own[v] >= 0:
            release[v] = max(release[v], release[own[v]] + (kind[v] == supervisor))
        for i in range(pred_base[v], pred_base[v + 1]):
            release[v] = max(release[v], release[pred[i]] + (kind[pred[i]] == supervisor))
    for q in range(total - 1, -1, -1):
        v = queue[q]
        if kind[v] == supervisor:
            deadline[v] = release[v]
        if own[v] >= 0:
            deadline[own[v]] = min(deadline[own[v]], deadline[v])
        for i in range(pred_base[v], pred_base[v + 1]):
            deadline[pred[i]] = min(deadline[pred[i]], deadline[v])
    # By episode, deadline (the supervisor last), then topologically: a counting sort of the queue.
    base = np.zeros(len(passes) + 1, np.int64)
    episode = np.empty(total, np.int32)
    for e in range(len(passes)):
        base[e + 1] = base[e] + 2 * passes[e]
        episode[first[e] : first[e + 1]] = e
    fill = np.zeros(base[-1] + 1, np.int64)
    for v in range(total):
        fill[base[episode[v]] + 2 * deadline[v] + (kind[v] == supervisor) + 1] += 1
    for j in range(len(fill) - 1):
        fill[j + 1] += fill[j]
    place, order = np.empty(total, np.int32), np.empty(total, np.int32)
    for v in queue:
        key = base[episode[v]] + 2 * deadline[v] + (kind[v] == supervisor)
        place[v] = fill[key]
        order[place[v]] = v
        fill[key] += 1
    return place, order, release, deadline


@njit(cache=True)
def _topological(own, pred_base, pred):
    """Order the vertices as given, but none before what it depends on; fewer than all if there is a cycle."""
    total = len(own)
    in_order = True
    for v in range(total):
        for i in range(pred_base[v], pred_base[v + 1]):
            in_order &= pred[i] < v
    queue = np.arange(total).astype(np.int32)
    if in_order:
        return queue
    new, open_, done = 0, 1, 2
    mark, following = np.full(total, new, np.int8), pred_base[:-1].copy()
    stack = np.empty(total, np.int32)
    size = 0
    for start in range(total):
        depth = 0
        if mark[start] == new:
            stack[0] = start
            mark[start] = open_
            depth = 1
        while depth > 0:
            v = stack[depth - 1]
            waits = np.int32(-1)
            if own[v] >= 0 and mark[own[v]] != done:
                waits = own[v]
            while waits < 0 and following[v] < pred_base[v + 1]:
                p = pred[following[v]]
                following[v] += 1
                if mark[p] != done:
                    waits = p
            if waits >= 0:
                if mark[waits] == open_:
                    return queue[:0]
                mark[waits] = open_
                stack[depth] = waits
                depth += 1
            else:
                mark[v] = done
                queue[size] = v
                size += 1
                depth -= 1
    return queue


@njit(cache=True)
def _reorder(place, order, kind, pred_base, pred):
    """Move the dependencies with the vertices; of several on one kind the latest stands for all."""
    base, moved = np.zeros_like(pred_base), np.empty_like(pred)
    size = 0
    for p in range(len(order)):
        v = order[p]
        base[p] = size
        for i in range(pred_base[v], pred_base[v + 1]):
            known = base[p]
            while known < size and kind[order[moved[known]]] != kind[pred[i]]:
                known += 1
            if known == size:
                moved[size] = place[pred[i]]
                size += 1
            else:
                moved[known] = max(moved[known], place[pred[i]])
    base[len(order)] = size
    return base, moved[:size].copy()
