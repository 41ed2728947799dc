"""Windows: short stretches of episodes that a supergraph must master, cheap to check.

The window of passes a to b of an episode has all vertices that cannot run before a and must have run in b. Given
that everything else is done when pass a begins, a chain of slots in which one of them comes late does not
fit the episode: a few windows reject most bad chains, and one full embedding proves the good ones.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from deepkoco.graph.supergraph.embedding import SHIFT, at, next_position

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "3e84e99ee2aa9b90"


class Windows(NamedTuple):
    """Room for windows; the vertices of window w are the places first[w] to first[w + 1].

    Attributes:
        size: (1,) number of windows.
        order: (windows,) those that rejected something lately come first.
        first: (windows + 1,)
        kind, release, deadline: (places,) of each vertex, passes counted from the window's first.
        pred_base, pred: (places + 1,), (edges,) what a vertex depends on, as places from first[w].
        late: (windows,) vertices that are late, under the chain looked at last.
        position, ready, binding: (longest window,) for the window looked at last.
        last, last_vertex: (kinds,) the same.
    """

    size: np.ndarray
    order: np.ndarray
    first: np.ndarray
    kind: np.ndarray
    release: np.ndarray
    deadline: np.ndarray
    pred_base: np.ndarray
    pred: np.ndarray
    late: np.ndarray
    position: np.ndarray
    ready: np.ndarray
    binding: np.ndarray
    last: np.ndarray
    last_vertex: np.ndarray


def make_windows(kinds: int, longest: int, windows: int = 4096, places: int = 1 << 19) -> Windows:
    """Make room for windows of episodes of at most `longest` vertices."""
    places = max(places, 2 * longest)
    return Windows(
        size=np.zeros(1, np.int64),
        order=np.arange(windows),
        first=np.zeros(windows + 1, np.int64),
        kind=np.empty(places, np.int32),
        release=np.empty(places, np.int32),
        deadline=np.empty(places, np.int32),
        pred_base=np.zeros(places + 1, np.int64),
        pred=np.empty(4 * places, np.int32),
        late=np.zeros(windows, np.int64),
        position=np.empty(longest, np.int64),
        ready=np.empty(longest, np.int64),
        binding=np.empty(longest, np.int64),
        last=np.empty(kinds, np.int64),
        last_vertex=np.empty(kinds, np.int64),
    )


@njit(cache=True)
def add_window(parts, pass_first, episode, begin, end, windows):
    """Add passes `begin` to `end` of an episode; return whether there was room."""
    w = windows.size[0]
    n = windows.first[w]
    m = windows.pred_base[n]
    low, high = pass_first[begin], pass_first[end + 1]
    if w + 1 >= len(windows.first) or n + high - low > len(windows.kind):
        return False
    local = windows.binding  # free between two looks at a window
    start = n
    for v in range(low, high):
        local[v - low] = -1
        if parts.release[v] < begin or parts.kind[v] == parts.supervisor:
            continue
        windows.kind[n] = parts.kind[v]
        windows.release[n] = parts.release[v] - begin
        windows.deadline[n] = parts.deadline[v] - begin
        for i in range(parts.pred_base[v], parts.pred_base[v + 1]):
            p = parts.pred[i]
            if p >= low and local[p - low] >= 0:
                if m == len(windows.pred):
                    return False
                windows.pred[m] = local[p - low]
                m += 1
        local[v - low] = n - start
        n += 1
        windows.pred_base[n] = m
    windows.first[w + 1] = n
    windows.order[w] = w
    windows.late[w] = 0
    windows.size[0] += 1
    return True


@njit(cache=True)
def count_late(windows, w, next_slot, limit):
    """Count the vertices of a window that are late, at most limit + 1."""
    position, last = windows.position, windows.last
    last[:] = -1
    first, late = at(windows.first[w]), 0
    i = at(windows.pred_base[first])
    for vertex in range(windows.first[w], windows.first[w + 1]):
        v = at(vertex)
        k = at(windows.kind[v])
        ready = max(np.int64(windows.release[v]) << SHIFT, last[k] + 1)
        end = at(windows.pred_base[v + at(1)])
        while i < end:
            ready = max(ready, position[at(windows.pred[i])] + 1)
            i += at(1)
        place = next_position(ready, k, next_slot)
        position[v - first] = place
        last[k] = place
        if place >= (np.int64(windows.deadline[v]) + 1) << SHIFT:
            late += 1
            if late > limit:
                return late
    return late


@njit(cache=True)
def count_all_late(windows, next_slot, limit, late, visited):
    """Count the late vertices of all windows, into `late` (windows,); stop beyond the limit."""
    total = 0
    for o in range(windows.size[0]):
        w = windows.order[o]
        late[w] = count_late(windows, w, next_slot, limit - total)
        visited[0] += windows.first[w + 1] - windows.first[w]
        total += late[w]
        if total > limit:
            windows.order[o], windows.order[o // 2] = windows.order[o // 2], w
            return total
    return total


@njit(cache=True)
def find_shortage(windows, w, size, next_slot, generator):
    """Choose why a window is late: a kind that had to be waited for, and the slots from where to where.

    From the first late vertex back along what it waited for; one vertex on this path that waited for a slot
    of its kind is drawn.
    """
    position, ready_at, binding = windows.position, windows.ready, windows.binding
    last, last_vertex = windows.last, windows.last_vertex
    last[:] = -1
    first, late = windows.first[w], -1
    for v in range(first, windows.first[w + 1]):
        k, bound = windows.kind[v], np.int64(-1)
        ready = np.int64(windows.release[v]) << SHIFT
        for i in range(windows.pred_base[v], windows.pred_base[v + 1]):
            if position[windows.pred[i]] + 1 > ready:
                ready = position[windows.pred[i]] + 1
                bound = np.int64(windows.pred[i])
        if last[k] + 1 > ready:
            ready, bound = last[k] + 1, last_vertex[k]
        place = next_position(ready, k, next_slot)
        position[v - first], ready_at[v - first], binding[v - first] = place, ready, bound
        last[k], last_vertex[k] = place, v - first
        if place >= (np.int64(windows.deadline[v]) + 1) << SHIFT:
            late = v - first
            break
    chosen, waiting, v = late, 0, late
    while v >= 0:
        if position[v] > ready_at[v]:
            waiting += 1
            if draw(generator, waiting) == 0:
                chosen = v
        v = binding[v]
    mask = (1 << SHIFT) - 1
    begin, end = ready_at[chosen] & mask, position[chosen] & mask
    if position[chosen] >> SHIFT > ready_at[chosen] >> SHIFT:
        end += size
    return windows.kind[first + chosen], begin, end


@njit(cache=True)
def draw(generator, bound):
    """Draw from 0 to bound - 1; xorshift, so that no library decides what comes out."""
    x = generator[0]
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    x ^= x << np.uint64(17)
    generator[0] = x
    return np.int64((x >> np.uint64(11)) % np.uint64(bound))
