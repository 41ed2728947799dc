"""Cut a chain of slots down to a length, by the slots that no known window misses."""

import numpy as np
from numba import njit

from deepkoco.graph.supergraph.embedding import LONGEST, embed_episode, fill_next
from deepkoco.graph.supergraph.windows import count_all_late, count_late, draw

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "6a572c927e7c73f7"

FILL = 48  # entries of the table of next slots that take as long as a visit


@njit(cache=True)
def count_use(parts, slots, size, next_slot, position, last, use):
    """Count the vertices that each slot runs."""
    fill_next(slots, size, next_slot)
    use[:size] = 0
    for e in range(len(parts.passes)):
        embed_episode(parts, e, size, next_slot, position, last)
        for v in range(parts.first[e], parts.first[e + 1]):
            if parts.kind[v] != parts.supervisor:
                use[position[v] & (LONGEST - 1)] += 1


@njit(cache=True)
def shorten(slots, size, target, bound, count, use, windows, next_slot, late, spare, generator, visited):
    """Delete slots until `target` are left: those that no window uses, else those that fewest miss."""
    while size > target:
        shorter = _delete_unused(slots, size, target, bound, count, use, windows, next_slot, visited)
        if shorter > target:
            chosen = _choose_deletion(
                slots, shorter, bound, count, use, windows, next_slot, late, spare, generator, visited
            )
            if chosen < 0:
                return shorter
            shorter = _delete(slots, shorter, chosen, count, use)
        size = shorter
    return size


@njit(cache=True)
def _delete(slots, size, slot, count, use):
    count[slots[slot]] -= 1
    for i in range(slot, size - 1):
        slots[i], use[i] = slots[i + 1], use[i + 1]
    return size - 1


@njit(cache=True)
def _delete_unused(slots, size, target, bound, count, use, windows, next_slot, visited):
    """Delete slots that run nothing in any window, so that all windows stay as they are; the idlest first."""
    fill_next(slots, size, next_slot)
    taken = np.zeros(size, np.bool_)
    for w in range(windows.size[0]):
        count_late(windows, w, next_slot, 1 << 60)
        n = windows.first[w + 1] - windows.first[w]
        visited[0] += n
        for v in range(n):
            taken[windows.position[v] & (LONGEST - 1)] = True
    order = np.argsort(use[:size], kind="mergesort")
    deleted = np.zeros(size, np.bool_)
    surplus = size - target
    for i in order:
        if surplus > 0 and not taken[i] and count[slots[i]] > bound[slots[i]]:
            deleted[i] = True
            count[slots[i]] -= 1
            surplus -= 1
    n = 0
    for i in range(size):
        if not deleted[i]:
            slots[n], use[n] = slots[i], use[i]
            n += 1
    return n


@njit(cache=True)
def _choose_deletion(slots, size, bound, count, use, windows, next_slot, late, spare, generator, visited):
    """Choose the slot without which fewest vertices are late; -1 if all kinds are down to the bound."""
    tried = np.zeros(size, np.bool_)
    chosen, fewest = -1, np.int64(1 << 60)
    while fewest > 0:
        slot = np.int64(-1)
        for _look in range(3):  # three draws, the least used of them
            drawn, open_ = np.int64(-1), 0
            for i in range(size):
                if not tried[i] and count[slots[i]] > bound[slots[i]]:
                    open_ += 1
                    if draw(generator, open_) == 0:
                        drawn = i
            if drawn >= 0 and (slot < 0 or use[drawn] < use[slot]):
                slot = drawn
        if slot < 0:
            break
        tried[slot] = True
        spare[:slot] = slots[:slot]
        spare[slot : size - 1] = slots[slot + 1 : size]
        fill_next(spare, size - 1, next_slot)
        visited[0] += size * len(count) // FILL
        missed = count_all_late(windows, next_slot, fewest - 1, late, visited)
        if missed < fewest:
            chosen, fewest = slot, missed
    return chosen
