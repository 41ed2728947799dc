"""The published search: grow a supergraph by the largest common subgraph with one partition after the other.

Source: thesis Algorithms 4 and 5, in the readings of the author's production code. Lines 10, 17 and 18 of
Algorithm 4 mean the missing subgraph (Eq. 3.1), line 17 of Algorithm 5 compares the sizes of matches. The
supergraph stays a chain while it grows, and changes only where a partition matches partly; what re-matching
the last partitions leaves unused is deleted; in the end slots of one kind in one generation are merged.
What the text leaves to chance (sets in no order) is taken in the order of the kinds here.
"""

from collections import deque

import numpy as np

from deepkoco.graph.supergraph.embedding import Supergraph
from deepkoco.graph.supergraph.partition import Partitions

BACKTRACK = 20  # beta
Front = dict[int, int]  # by kind, the vertex that can run next: stateful vertices, at most one of a kind
Match = dict[int, int]  # slot of each vertex


def grow_common(parts: Partitions, backtrack: int = BACKTRACK) -> Supergraph:
    """Grow a supergraph partition by partition (`mcs`).

    Args:
        parts: the episodes; a step is held back by nothing but what it depends on (no `earliest`).
        backtrack: partitions, at most, that are matched again after the supergraph has grown.
    """
    growth = _Growth(parts)
    for episode in range(len(parts.passes)):
        growth.add_episode(episode, backtrack)
    return growth.merged()


class _Growth:
    def __init__(self, parts: Partitions) -> None:
        self.supervisor = parts.supervisor
        self.first, self.passes = parts.first.tolist(), parts.passes.tolist()
        self.kind, self.deadline = parts.kind.tolist(), parts.deadline.tolist()
        self.after, self.degree = _successors(parts)
        self.chain: list[int] = []
        self.slot_kind: dict[int, int] = {}
        self.edges: set[tuple[int, int]] = set()

    def add_episode(self, episode: int, backtrack: int) -> None:
        """Match the partitions of an episode in turn, growing the chain where one does not match."""
        begin, end = self.first[episode], self.first[episode + 1]
        groups: list[list[int]] = [[] for _ in range(self.passes[episode])]
        for v in range(begin, end):
            groups[self.deadline[v]].append(v)
        self.met = dict.fromkeys(range(begin, end), 0)  # matched predecessors
        front: Front = {}
        for v in range(begin, end):
            if self.degree[v] == 0:
                self._enter(front, v)
        matched: dict[int, tuple[int, int]] = {}
        history: deque = deque(maxlen=backtrack + 1)
        unused: set[int] = set()
        repeat, j = 0, 0
        while j < len(groups):
            leaf = groups[j][-1]
            needed = [v for v in groups[j][:-1] if v not in matched]
            log: list[int] = []
            own: list[int] = []
            history.append((j, dict(front), log, own))
            start = dict(front)
            match = self._match(front, log)
            if all(v in match for v in needed):
                front.pop(self.supervisor)
                own += [*match, leaf]
                matched |= {v: (j, s) for v, s in match.items()}
                matched[leaf] = (j, -1)
                self._release(front, leaf, log)
                unused -= set(match.values())
                repeat = max(repeat - 1, 0)
                if repeat == 0 and unused:
                    self.chain = [s for s in self.chain if s not in unused]
                    unused = set()
                j += 1
                continue
            self._undo(log)
            match = self._largest(start, set(needed))
            unused = self._unify(needed, match)
            repeat = len(history)
            for _, _, past, vertices in history:
                self._undo(past)
                for v in vertices:
                    del matched[v]
            j, front = history[0][0], dict(history[0][1])
            history.clear()
        for v, (turn, slot) in matched.items():
            for w in self.after[v]:
                if slot >= 0 and matched[w][0] == turn and matched[w][1] >= 0:
                    self.edges.add((slot, matched[w][1]))

    def _enter(self, front: Front, vertex: int) -> None:
        if self.kind[vertex] in front:
            raise ValueError(f"two vertices of kind {self.kind[vertex]} could run at once")
        front[self.kind[vertex]] = vertex

    def _release(self, front: Front, vertex: int, log: list[int]) -> None:
        for w in self.after[vertex]:
            self.met[w] += 1
            log.append(w)
            if self.met[w] == self.degree[w]:
                self._enter(front, w)

    def _undo(self, log: list[int]) -> None:
        for w in log:
            self.met[w] -= 1
        log.clear()

    def _match(self, front: Front, log: list[int]) -> Match:
        """Run once through the chain; the front moves on (Alg. 5, inner loop)."""
        match: Match = {}
        for slot in self.chain:
            vertex = front.pop(self.slot_kind[slot], None)
            if vertex is not None:
                match[vertex] = slot
                self._release(front, vertex, log)
        return match

    def _largest(self, front: Front, needed: set[int]) -> Match:
        """Leave out vertices of the front, layer by layer, until most of what is needed matches (Alg. 5)."""
        best: Match = {}
        largest, excluded = 0, 0
        lasting: list[int] = []
        while excluded < len(needed):
            constrained = [front[k] for k in sorted(front) if front[k] in needed]
            optional = {k: v for k, v in front.items() if v not in needed}
            for kept in range(len(constrained), 0, -1):
                reachable = len(needed) - excluded - (len(constrained) - kept)
                if largest == len(self.chain) or reachable <= largest:
                    self._undo(lasting)
                    return best
                log: list[int] = []
                trial = optional | {self.kind[v]: v for v in constrained[:kept]}
                for v in constrained[kept:]:
                    self._release(trial, v, log)
                match = self._match(trial, log)
                self._undo(log)
                size = sum(v in needed for v in match)
                if size > largest:
                    best, largest = match, size
            excluded += len(constrained)
            front = optional
            for v in constrained:
                self._release(front, v, lasting)
        self._undo(lasting)
        return best

    def _unify(self, needed: list[int], match: Match) -> set[int]:
        """Add what is missing (P-) to the chain, in a topological order of both; return the new slots."""
        names = dict(match)
        new: set[int] = set()
        for v in needed:
            if v not in names:
                names[v] = len(self.slot_kind)
                self.slot_kind[names[v]] = self.kind[v]
                new.add(names[v])
        after: dict[int, set[int]] = {s: set() for s in [*self.chain, *sorted(new)]}
        for a, b in zip(self.chain, self.chain[1:], strict=False):
            after[a].add(b)
        for v, slot in names.items():
            after[slot] |= {names[w] for w in self.after[v] if w in names}
        generation = _generations(after)
        place = {s: i for i, s in enumerate(self.chain)}
        last = len(place)
        self.chain = sorted(after, key=lambda s: (generation[s], place.get(s, last), self.slot_kind[s], s))
        return new

    def merged(self) -> Supergraph:
        """Slots in the generations of the edges that are used; of one kind, one in a generation."""
        after: dict[int, set[int]] = {s: set() for s in self.chain}
        for a, b in self.edges:
            after[a].add(b)
        generation = _generations(after)
        slots = sorted({(generation[s], self.slot_kind[s]) for s in self.chain})
        # Merging leaves no generation empty: each slot has one of the generation before it.
        return Supergraph(
            np.array([k for _, k in slots], dtype=np.int64), np.array([g for g, _ in slots], dtype=np.int64)
        )


def _successors(parts: Partitions) -> tuple[list[list[int]], list[int]]:
    after: list[list[int]] = [[] for _ in range(parts.work)]
    degree = np.diff(parts.pred_base).tolist()
    base, pred = parts.pred_base.tolist(), parts.pred.tolist()
    kind = parts.kind.tolist()
    for begin, end in zip(parts.first[:-1].tolist(), parts.first[1:].tolist(), strict=True):
        last: dict[int, int] = {}
        for v in range(begin, end):
            for p in pred[base[v] : base[v + 1]]:
                after[p].append(v)
            if kind[v] in last:
                after[last[kind[v]]].append(v)
                degree[v] += 1
            last[kind[v]] = v
    return after, degree


def _generations(after: dict[int, set[int]]) -> dict[int, int]:
    """Length of the longest path to each slot."""
    waits = dict.fromkeys(after, 0)
    for following in after.values():
        for s in following:
            waits[s] += 1
    generation, depth = {}, 0
    layer = [s for s, n in waits.items() if n == 0]
    while layer:
        coming = []
        for s in layer:
            generation[s] = depth
            for w in after[s]:
                waits[w] -= 1
                if waits[w] == 0:
                    coming.append(w)
        layer, depth = coming, depth + 1
    return generation
