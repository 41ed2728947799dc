"""The timing rules, event by event, in integer ticks; compiled, one environment after the other."""

import numpy as np
from numba import njit

DONE, FULL, STUCK = 0, 1, 2


@njit(cache=True)
def run_rows(
    steps,  # supervisor steps to run before the last one, whose start ends the episode
    supervisor,
    rank,  # (N,) place of each node in the topological order
    ancestor,  # (N, N) bool, [n, m]: messages that are not skipped lead from m to n
    frequency,  # (N,) bool, else phase scheduling
    unscheduled,  # (N,) bool: starts as soon as its blocking inputs are there
    step_base,  # (N + 1,) first column of each node's steps
    tick_base,  # (N,) first column of each node's ticks, one more than its steps
    ticks,  # nominal start of every step
    sender,  # (E,)
    receiver,  # (E,)
    skip,  # (E,) bool
    blocking,  # (E,) bool
    fifo,  # (E,) bool
    nominal,  # (E,) expected age of a message on arrival, or -1: taken as soon as it is there
    window,  # (E,)
    message_base,  # (E + 1,) first column of each connection's messages
    window_base,  # (E + 1,) first column of each connection's windows
    computation,  # (R, steps) delays
    communication,  # (R, messages) delays
    recorded,  # (R, steps) measured starts, or no columns at all
    t_start,  # (R, steps) out
    t_end,  # (R, steps) out
    t_received,  # (R, messages) out
    windows,  # (R, windows) out: seq of the messages that each step sees, oldest first
    boundary,  # (R, steps + 1, N) out: steps of every node that started before each supervisor step
):
    """Fill the output arrays; return DONE, FULL (a node ran out of columns) or STUCK."""
    replay = recorded.shape[1] > 0
    nodes, edges = len(rank), len(sender)
    count = np.zeros(nodes, np.int64)
    shift = np.zeros(nodes, np.int64)
    ready = np.zeros(nodes, np.int64)
    known = np.zeros(nodes, np.bool_)
    taken = np.zeros(edges, np.int64)
    widest = 1
    for e in range(edges):
        widest = max(widest, window[e])
    seen = np.zeros((edges, widest), np.int64)
    picked = np.zeros(message_base[-1], np.bool_)
    for row in range(len(computation)):
        count[:] = 0
        shift[:] = 0
        known[:] = False
        taken[:] = 0
        picked[:] = False
        for e in range(edges):
            for i in range(window[e]):
                seen[e, i] = i - window[e]
        while True:
            # Rule 3: the start of every next step whose awaited messages have all been sent.
            for n in range(nodes):
                if known[n]:
                    continue
                k = count[n]
                if k >= step_base[n + 1] - step_base[n]:
                    return FULL
                tick = ticks[tick_base[n] + k]
                start = 0 if unscheduled[n] else tick + shift[n]
                if k > 0:
                    start = max(start, t_end[row, step_base[n] + k - 1])
                complete = True
                for e in range(edges):
                    if receiver[e] != n or not blocking[e]:
                        continue
                    # Rule 2: wait for all messages that were nominally started since the last tick.
                    s, i = sender[e], taken[e]
                    while i < step_base[s + 1] - step_base[s]:
                        begun = ticks[tick_base[s] + i]
                        if begun > tick or (skip[e] and begun == tick):
                            break
                        if i >= count[s]:
                            # A measured start did not wait for what arrived after it.
                            complete = False
                            if replay:
                                column = step_base[s] + i
                                age = computation[row, column] + communication[row, message_base[e] + i]
                                complete = recorded[row, column] + age > recorded[row, step_base[n] + k]
                            break
                        start = max(start, t_received[row, message_base[e] + i])
                        i += 1
                    if i >= step_base[s + 1] - step_base[s] and not replay:
                        return FULL
                    if not complete:
                        break
                ready[n] = recorded[row, step_base[n] + k] if replay else start
                known[n] = complete
            # The next step is the earliest; at one instant senders come first.
            n = -1
            for m in range(nodes):
                if not known[m]:
                    continue
                if n < 0 or ready[m] < ready[n]:
                    n = m
                elif replay and n == supervisor and count[n] == steps and ready[m] == ready[n]:
                    n = m  # whatever was measured came before the end
                elif replay and m == supervisor and count[m] == steps:
                    continue
                elif ready[m] == ready[n]:
                    waits_m, waits_n = False, False
                    for a in range(nodes):
                        waits_m |= ancestor[m, a] and not known[a]
                        waits_n |= ancestor[n, a] and not known[a]
                    if (waits_n and not waits_m) or (waits_m == waits_n and rank[m] < rank[n]):
                        n = m
            if n < 0:
                return STUCK
            k, now = count[n], ready[n]
            column = step_base[n] + k
            for e in range(edges):
                if receiver[e] != n:
                    continue
                s, base, size = sender[e], message_base[e], window[e]
                if blocking[e]:
                    tick = ticks[tick_base[n] + k]
                    while taken[e] < count[s]:  # all that were awaited; a measured start may precede some
                        begun = ticks[tick_base[s] + taken[e]]
                        late = t_received[row, base + taken[e]] > now
                        if begun > tick or (skip[e] and begun == tick) or late:
                            break
                        _push(seen[e], size, taken[e])
                        taken[e] += 1
                else:
                    # Rule 5: take everything that has arrived, in the order of arrival.
                    while True:
                        best = -1
                        for i in range(taken[e], count[s]):
                            if picked[base + i]:
                                continue
                            arrival = t_received[row, base + i]
                            if nominal[e] >= 0:
                                arrival = max(arrival, ticks[tick_base[s] + i] + nominal[e])
                            if arrival > now or (skip[e] and arrival == now):
                                if fifo[e]:
                                    break
                                continue
                            if best < 0 or t_received[row, base + i] < t_received[row, base + best]:
                                best = i
                            if fifo[e]:
                                break
                        if best < 0:
                            break
                        picked[base + best] = True
                        _push(seen[e], size, best)
                        while taken[e] < count[s] and picked[base + taken[e]]:
                            taken[e] += 1
                for i in range(size):
                    windows[row, window_base[e] + k * size + i] = seen[e, i]
            # Rule 4: the end of the step and the arrival of its messages.
            t_start[row, column] = now
            t_end[row, column] = now + computation[row, column]
            if n == supervisor:
                for m in range(nodes):
                    boundary[row, k, m] = count[m]
                if k == steps:
                    break
            for e in range(edges):
                if sender[e] != n:
                    continue
                arrival = t_end[row, column] + communication[row, message_base[e] + k]
                if fifo[e] and k > 0:
                    arrival = max(arrival, t_received[row, message_base[e] + k - 1])
                t_received[row, message_base[e] + k] = arrival
            if frequency[n]:
                # An own overrun (computation longer than the period) shifts later ticks, waiting does not.
                period = ticks[tick_base[n] + k + 1] - ticks[tick_base[n] + k]
                shift[n] += max(0, computation[row, column] - period)
            count[n] += 1
            known[n] = False
    return DONE


@njit(cache=True)
def _push(seen, size, message):
    for i in range(size - 1):
        seen[i] = seen[i + 1]
    seen[size - 1] = message
