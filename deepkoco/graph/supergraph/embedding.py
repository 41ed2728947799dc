"""Embedding: which slot, of which pass, runs each step.

The supergraph is a chain of slots that is run through once per pass, so the slots of all passes form one long
line. A step goes into the first slot of its kind behind everything it depends on. As the steps of a kind are
run in their order, no other choice brings any step forward: if this one misses a deadline, the episode does
not fit.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from deepkoco.graph.supergraph.partition import Partitions

SHIFT = 16  # a position is pass * 2**16 + slot
LONGEST = 1 << SHIFT
MOST = (1 << 15) - 2  # slots
_ABSENT = (1 << 15) - 1
NEVER = 1 << 60


class Supergraph(NamedTuple):
    """Slots in generations, those of one generation independent of each other; the supervisor comes last.

    Attributes:
        kind: (L,) node that each slot runs, the supervisor's own slot left out.
        generation: (L,) of each slot, not decreasing; a kind has at most one slot in a generation.
    """

    kind: np.ndarray
    generation: np.ndarray

    @classmethod
    def chain(cls, slots: np.ndarray) -> "Supergraph":
        """Return the supergraph in which every slot is a generation of its own."""
        return cls(np.asarray(slots, np.int64), np.arange(len(slots)))

    @property
    def size(self) -> int:
        """Number of slots |S|, that of the supervisor included."""
        return len(self.kind) + 1


class Embedding(NamedTuple):
    """Where every vertex runs.

    Attributes:
        turn: (V,) pass of each vertex.
        generation: (V,) of its slot; that of the supervisor is behind all others.
    """

    turn: np.ndarray
    generation: np.ndarray


def embed(parts: Partitions, supergraph: Supergraph) -> Embedding | None:
    """Embed all episodes in a supergraph; None if one of them does not fit."""
    size = int(supergraph.generation[-1]) + 1 if len(supergraph.generation) else 0
    position, late = _embed_all(parts, supergraph.kind, supergraph.generation, size)
    if late >= 0:
        return None
    return Embedding(position >> SHIFT, position & (LONGEST - 1))


def grow(parts: Partitions, slots: np.ndarray) -> np.ndarray:
    """Add slots to a supergraph, only where an episode does not fit, until all do.

    A slot for the first step that comes too late is put behind those of its pass that are there already.

    Returns:
        (L',) kinds of the slots, the given ones in their order among them.
    """
    if len(slots) > MOST:
        raise ValueError(f"{len(slots)} slots are more than {MOST}")
    room = _with_room(np.asarray(slots, np.int32), min(2 * parts.kinds + len(slots), MOST - len(slots)))
    size = len(slots)
    while True:
        next_slot = np.empty((len(room) + 1, parts.kinds), np.int16)
        size, _, full = grow_slots(parts, room, size, next_slot)
        if not full:
            return room[:size].copy()
        if len(room) == MOST:
            raise ValueError(f"a pass does not fit in {MOST} slots")
        room = _with_room(room, min(len(room), MOST - len(room)))


def _with_room(slots: np.ndarray, more: int) -> np.ndarray:
    return np.concatenate([slots, np.zeros(more, np.int32)])


@njit(cache=True)
def fill_next(slots, size, next_slot):
    """Work out for every slot and kind the next slot of that kind, itself included."""
    kinds = next_slot.shape[1]
    for k in range(kinds):
        next_slot[size, k] = _ABSENT
    for s in range(size - 1, -1, -1):
        for k in range(kinds):
            next_slot[s, k] = next_slot[s + 1, k]
        next_slot[s, slots[s]] = s


@njit(inline="always")
def at(index):
    """An index that is never negative: of a signed one numba looks at every access whether it counts from behind."""
    return np.uint64(index)


@njit(inline="always")
def next_position(ready, kind, next_slot):
    """First position of a kind at or behind `ready`."""
    slot = ready & (LONGEST - 1)
    there = np.int64(next_slot[at(slot), at(kind)])
    if there < _ABSENT:
        return ready - slot + there
    there = np.int64(next_slot[at(0), at(kind)])
    if there < _ABSENT:
        return ready - slot + LONGEST + there
    return NEVER


@njit(cache=True)
def embed_episode(parts, episode, size, next_slot, position, last):
    """Place the vertices of an episode; return the first that is late (its place: when it is ready), or -1."""
    last[:] = -1
    for vertex in range(parts.first[episode], parts.first[episode + 1]):
        v = at(vertex)
        k = at(parts.kind[v])
        if k == at(parts.supervisor):
            position[v] = (np.int64(parts.deadline[v]) << SHIFT) + size
            continue
        ready = max(np.int64(parts.release[v]) << SHIFT, last[k] + 1)
        i, end = at(parts.pred_base[v]), at(parts.pred_base[v + at(1)])
        while i < end:
            ready = max(ready, position[at(parts.pred[i])] + 1)
            i += at(1)
        position[v] = next_position(ready, k, next_slot)
        if position[v] >= (np.int64(parts.deadline[v]) + 1) << SHIFT:
            position[v] = ready
            return vertex
        last[k] = position[v]
    return -1


@njit(cache=True)
def _embed_all(parts, kind, generation, size):
    position, last = np.empty(len(parts.kind), np.int64), np.empty(parts.kinds, np.int64)
    next_slot = np.full((size + 1, parts.kinds), _ABSENT, np.int16)
    s = len(kind) - 1
    for g in range(size - 1, -1, -1):
        next_slot[g] = next_slot[g + 1]
        while s >= 0 and generation[s] == g:
            next_slot[g, kind[s]] = g
            s -= 1
    for episode in range(len(parts.passes)):
        late = embed_episode(parts, episode, size, next_slot, position, last)
        if late >= 0:
            return position, late
    return position, -1


@njit(cache=True)
def grow_slots(parts, slots, size, next_slot):
    """Insert slots until all episodes fit; return their number, the vertices visited, and whether room ended."""
    position, last = np.empty(len(parts.kind), np.int64), np.empty(parts.kinds, np.int64)
    fill_next(slots, size, next_slot)
    visited = 0
    for episode in range(len(parts.passes)):
        while True:
            late = embed_episode(parts, episode, size, next_slot, position, last)
            if late < 0:
                visited += parts.first[episode + 1] - parts.first[episode]
                break
            visited += late - parts.first[episode]
            if size == len(slots):
                return size, visited, True
            # Behind all that the same pass has run so far: the vertices are in the order of time, and slots
            # in that order are what the next passes will ask for.
            where, before = position[late], late - 1
            while before >= parts.first[episode] and parts.deadline[before] == parts.deadline[late]:
                if parts.kind[before] != parts.supervisor:
                    where = max(where, position[before] + 1)
                before -= 1
            where &= LONGEST - 1
            for s in range(size, where, -1):
                slots[s] = slots[s - 1]
            slots[where] = parts.kind[late]
            size += 1
            fill_next(slots, size, next_slot)
    return size, visited, False
