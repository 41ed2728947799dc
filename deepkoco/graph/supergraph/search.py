"""Search for a short chain of slots that all episodes fit in.

Between a chain that fits (from `grow`) and the lower bound, halve: cut a chain down to the target length
by slots that no known window misses, then repair it. Repairing moves one slot at a time: a window with a late
vertex says which kind it had to wait for and where, a slot of another place goes there; the move stays
unless more vertices are late after it (rarely a few more may be). When no window is late, all episodes are
embedded, and where one does not fit, the stretch in which it fails becomes a further window.

All decisions are made in integers with a generator of our own, and the budget counts visited vertices instead
of time: the same episodes give the same supergraph on any machine.
"""

import numpy as np
from numba import njit

from deepkoco.graph.supergraph.bounds import window_bound
from deepkoco.graph.supergraph.embedding import MOST, embed_episode, fill_next, grow, grow_slots
from deepkoco.graph.supergraph.partition import Partitions
from deepkoco.graph.supergraph.shortening import FILL, count_use, shorten
from deepkoco.graph.supergraph.windows import (
    add_window,
    count_all_late,
    count_late,
    draw,
    find_shortage,
    make_windows,
)

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "32c950b54b294f57"

EFFORT = 75
"""Visits of every vertex that a search may spend; more for chains of many slots of a kind, and in tiny problems."""

_LEAST = 30_000  # visits that every search may spend: few enough for no wait, enough for the optimum of tiny problems
_TRY = 10  # a try to reach one length may spend this part of the budget
_PATIENCE = 5  # tries without any gain after which it ends
_UPHILL = (8, 80)  # of 2048 moves, those that may leave 2 and 1 more vertices late
_FAILURES = 8  # further windows from an embedding of all episodes


def find_slots(parts: Partitions, effort: int = EFFORT, seed: int = 0) -> np.ndarray:
    """Search for a short supergraph.

    Args:
        parts: the episodes.
        effort: visits of every vertex that the search may spend.
        seed: of the search's own draws.

    Returns:
        (L,) int64 kind of each slot, without the supervisor's own at the end; it fits all episodes.
    """
    bound = window_bound(parts)
    slots = grow(parts, np.zeros(0, np.int32))
    if len(slots) + 1 <= bound.sum():
        return slots.astype(np.int64)
    pass_base, pass_first = _pass_first(parts)
    longest = int(np.diff(parts.first).max())
    windows = make_windows(parts.kinds, longest)
    add_hardest(parts, pass_base, pass_first, windows)
    budget = max(_LEAST, effort * parts.work * max(1, len(slots) // (5 * parts.kinds)))
    generator = np.array([np.random.SeedSequence(seed).generate_state(1, np.uint64)[0] | np.uint64(1)])
    return _search(parts, slots, bound, pass_base, pass_first, windows, budget, generator).astype(np.int64)


@njit(cache=True)
def _pass_first(parts):
    """First vertex with each deadline: episode e's pass j is place base[e] + j, its end the one after."""
    base = np.zeros(len(parts.passes) + 1, np.int64)
    for e in range(len(parts.passes)):
        base[e + 1] = base[e] + parts.passes[e] + 1
    first = np.zeros(base[-1], np.int64)
    for e in range(len(parts.passes)):
        v = parts.first[e]
        for j in range(parts.passes[e] + 1):
            while v < parts.first[e + 1] and parts.deadline[v] < j:
                v += 1
            first[base[e] + j] = v
    return base, first


@njit(cache=True)
def add_hardest(parts, pass_base, pass_first, windows):
    """Add the passes in which a kind, or all kinds together, must run most often."""
    most = np.zeros((parts.kinds + 1, 3), np.int64)
    count = np.zeros(parts.kinds + 1, np.int64)
    for e in range(len(parts.passes)):
        for j in range(parts.passes[e]):
            count[:] = 0
            for v in range(pass_first[pass_base[e] + j], pass_first[pass_base[e] + j + 1]):
                if parts.release[v] == j and parts.kind[v] != parts.supervisor:
                    count[parts.kind[v]] += 1
                    count[parts.kinds] += 1
            for k in range(parts.kinds + 1):
                if count[k] > most[k, 0]:
                    most[k, 0], most[k, 1], most[k, 2] = count[k], e, j
    for k in range(parts.kinds + 1):
        known = most[k, 0] == 0
        for other in range(k):
            known |= most[other, 1] == most[k, 1] and most[other, 2] == most[k, 2]
        if not known:
            e, j = most[k, 1], most[k, 2]
            add_window(parts, pass_first[pass_base[e] :], e, j, j, windows)


@njit(cache=True)
def _search(parts, best, bound, pass_base, pass_first, windows, budget, generator):
    room = min(2 * len(best) + 2 * parts.kinds, MOST)
    next_slot = np.empty((room + 1, parts.kinds), np.int16)
    slots, spare = np.empty(room, np.int32), np.empty(room, np.int32)
    use, late = np.empty(room, np.int64), np.empty(len(windows.late), np.int64)
    position, last = np.empty(len(parts.kind), np.int64), np.empty(parts.kinds, np.int64)
    order = np.arange(len(parts.passes))
    visited = np.zeros(1, np.int64)
    least = bound.sum() - 1
    step = max(1, (len(best) - least) // 2)
    measured = False
    in_vain = 0
    while len(best) > least and visited[0] < budget and in_vain < _PATIENCE:
        size = len(best)
        slots[:size] = best
        count = np.zeros(parts.kinds, np.int64)
        for k in best:
            count[k] += 1
        if not measured:
            count_use(parts, slots, size, next_slot, position, last, use)
            visited[0] += len(parts.kind)
            measured = True
        size = shorten(
            slots,
            size,
            max(least, size - step),
            bound,
            count,
            use,
            windows,
            next_slot,
            late,
            spare,
            generator,
            visited,
        )
        limit = min(budget, visited[0] + budget // _TRY)
        fits = False
        while not fits and _repair(
            slots, size, bound, count, windows, next_slot, late, spare, generator, visited, limit
        ):
            fill_next(slots, size, next_slot)
            failures = _find_failures(
                parts, size, next_slot, order, pass_base, pass_first, windows, position, last, visited
            )
            if failures < 0:  # no room for more windows: start collecting anew
                windows.size[0] = 0
                add_hardest(parts, pass_base, pass_first, windows)
                break
            fits = failures == 0
        if not fits:
            step = max(1, step // 2)
            size, more, full = grow_slots(parts, slots, size, next_slot)
            visited[0] += more
            if full:
                size = len(best)
        in_vain += 1
        if size < len(best):
            best = slots[:size].copy()
            measured = False
            in_vain = 0
    return best


@njit(cache=True)
def _repair(slots, size, bound, count, windows, next_slot, late, spare, generator, visited, limit):
    """Move slots until no window has a late vertex; return whether that was reached."""
    fill_next(slots, size, next_slot)
    total = count_all_late(windows, next_slot, 1 << 60, windows.late, visited)
    while total > 0 and visited[0] < limit:
        violated, w = 0, 0
        for i in range(windows.size[0]):
            if windows.late[i] > 0:
                violated += 1
                if draw(generator, violated) == 0:
                    w = i
        fill_next(slots, size, next_slot)
        kind, begin, end = find_shortage(windows, w, size, next_slot, generator)
        visited[0] += windows.first[w + 1] - windows.first[w]
        insert = begin + draw(generator, end - begin + 1)
        if insert > size:
            insert -= size
        remove = _choose_removal(slots, size, kind, bound, count, generator)
        if remove < 0:
            return False
        n = 0
        for i in range(size + 1):
            if i == insert:
                spare[n] = kind
                n += 1
            if i < size and i != remove:
                spare[n] = slots[i]
                n += 1
        fill_next(spare, size, next_slot)
        visited[0] += 2 * size * len(count) // FILL
        uphill = 0
        chance = draw(generator, 2048)
        if chance < _UPHILL[0]:
            uphill = 2
        elif chance < _UPHILL[1]:
            uphill = 1
        missed = count_all_late(windows, next_slot, total + uphill, late, visited)
        if missed <= total + uphill:
            count[slots[remove]] -= 1
            count[kind] += 1
            slots[:size] = spare[:size]
            windows.late[: windows.size[0]] = late[: windows.size[0]]
            total = missed
    return total == 0


@njit(cache=True)
def _choose_removal(slots, size, kind, bound, count, generator):
    """Draw the slot that moves: one of the same kind, or of any of which there are more than the bound."""
    same = draw(generator, 2) == 0
    for _ in range(2):
        found, remove = 0, -1
        for i in range(size):
            if slots[i] == kind or (not same and count[slots[i]] > bound[slots[i]]):
                found += 1
                if draw(generator, found) == 0:
                    remove = i
        if remove >= 0:
            return remove
        same = False
    return -1


@njit(cache=True)
def _find_failures(parts, size, next_slot, order, pass_base, pass_first, windows, position, last, visited):
    """Embed the episodes and add a window for each that fails; return their number, -1 if there is no room."""
    failures = 0
    for o in range(len(order)):
        e = order[o]
        late = embed_episode(parts, e, size, next_slot, position, last)
        if late < 0:
            visited[0] += parts.first[e + 1] - parts.first[e]
            continue
        visited[0] += late - parts.first[e]
        end, length = np.int64(parts.deadline[late]), 1
        known, failing = 0, 0  # passes that are too few, and enough
        while True:
            begin = max(0, end - length + 1)
            if not add_window(parts, pass_first[pass_base[e] :], e, begin, end, windows):
                return -1
            w = windows.size[0] - 1
            visited[0] += 2 * (windows.first[w + 1] - windows.first[w])
            if count_late(windows, w, next_slot, 0) > 0:
                if length - known <= max(1, length // 8):
                    break
                windows.size[0] -= 1  # a shorter stretch may do
                failing, length = length, (length + known) // 2
            else:
                windows.size[0] -= 1  # the cause lies further back
                known = length
                length = 2 * length if failing == 0 else (known + failing + 1) // 2
        order[1 : o + 1] = order[:o].copy()
        order[0] = e
        failures += 1
        if failures == _FAILURES:
            break
    return failures
