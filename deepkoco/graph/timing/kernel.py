"""The timing rules, event by event, in integer ticks; compiled, one schedule after the other."""

import numpy as np
from numba import njit

DONE, FULL, STUCK, UNSTALLED = 0, 1, 2, 3
_INCOMPLETE, _COMPLETE, _HELD = 0, 1, 2
LOST = np.iinfo(np.int64).max // 4
"""Ticks: the arrival of a message that never arrives; everything from here on is never."""


@njit(cache=True)
def run_rows(steps, rules, columns, draws, measured, times):
    """Fill `times` by the rules; what was measured (see `Measured`) comes when it came.

    Returns:
        DONE, FULL (a node ran out of columns), STUCK, or UNSTALLED (the drawn stalls end before the episode).
    """
    nodes, edges = len(rules.rank), len(rules.sender)
    widest = 1
    for e in range(edges):
        widest = max(widest, rules.window[e])
    count = np.zeros(nodes, np.int64)
    taken = np.zeros(edges, np.int64)
    seen = np.zeros((edges, widest), np.int64)
    picked = np.zeros(columns.message_base[-1], np.bool_)
    for row in range(len(draws.values)):
        count[:] = 0
        taken[:] = 0
        picked[:] = False
        for e in range(edges):
            for i in range(rules.window[e]):
                seen[e, i] = i - rules.window[e]
        status = _run_row(row, steps, rules, columns, draws, measured, times, count, taken, seen, picked)
        if status != DONE:
            return status
    return DONE


@njit(cache=True)
def _run_row(row, steps, rules, columns, draws, measured, times, count, taken, seen, picked):
    nodes, edges = len(rules.rank), len(rules.sender)
    supervisor = rules.supervisor
    shift = np.zeros(nodes, np.int64)
    ready = np.zeros(nodes, np.int64)
    known = np.zeros(nodes, np.bool_)
    stale = np.ones(nodes, np.bool_)
    held = np.zeros(nodes, np.bool_)
    unknown = nodes
    last_arrival = np.zeros(edges, np.int64)
    stall = np.zeros(draws.stalled.shape[0], np.int64)
    while True:
        for n in range(nodes):
            if known[n] or not stale[n]:
                continue
            stale[n] = False
            if count[n] >= columns.step_base[n + 1] - columns.step_base[n]:
                return FULL
            start, state = _next_start(
                n, row, rules, columns, draws, measured, times, count, taken, shift, ready, known
            )
            if start < 0:
                return FULL
            held[n] = state == _HELD
            if held[n]:
                ready[n], stale[n] = start, True
            elif state == _COMPLETE:
                ready[n], known[n] = start, True
                unknown -= 1
        # The next step is the earliest; at one instant senders come first.
        n = -1
        for m in range(nodes):
            if not known[m]:
                continue
            if n < 0 or ready[m] < ready[n]:
                n = m
            elif ready[m] > ready[n]:
                continue
            elif _comes_first(m, n, rules, known, unknown):
                n = m
        n = _let_go(n, rules, ready, known, held)
        if n < 0:
            return STUCK
        if not known[n]:
            held[n], known[n] = False, True
            unknown -= 1
        if n == supervisor and count[n] == steps and measured.node[n]:
            n = _measured_before_end(n, rules, measured, ready, known, unknown)
        k, now = count[n], ready[n]
        column = columns.step_base[n] + k
        for j in range(rules.into_base[n], rules.into_base[n + 1]):
            e = rules.into[j]
            if rules.blocking[e]:
                _take_awaited(e, k, row, now, rules, columns, times, count, taken, seen, picked)
            else:
                _take_arrived(e, row, now, measured, rules, columns, times, count, taken, seen, picked)
            size = rules.window[e]
            for i in range(size):
                times.windows[row, columns.window_base[e] + k * size + i] = seen[e, i]
        # Rule 4: the end of the step and the arrival of its messages.
        times.t_start[row, column] = now
        if n == supervisor:
            for m in range(nodes):
                times.boundary[row, k, m] = count[m]
            if k == steps:
                times.t_end[row, column] = now
                return DONE
        for g in range(len(stall)):
            while stall[g] < draws.stall_end.shape[2] and draws.stall_end[row, g, stall[g]] <= now:
                stall[g] += 1
        work = draws.values[row, draws.first[n] + k * draws.stride[n]]
        end = _finish(row, n, now, work, draws, stall)
        if end < 0:
            return UNSTALLED
        times.t_end[row, column] = end
        for j in range(rules.out_base[n], rules.out_base[n + 1]):
            e = rules.out_of[j]
            channel = nodes + e
            work = draws.values[row, draws.first[channel] + k * draws.stride[channel]]
            arrival = LOST
            if work < LOST:
                arrival = _finish(row, channel, end, work, draws, stall)
                if arrival < 0:
                    return UNSTALLED
                # Measured messages come in the order in which they came; a lost one holds nothing back.
                if rules.fifo[e] and not measured.edge[e]:
                    arrival = max(arrival, last_arrival[e])
                    last_arrival[e] = arrival
            times.t_received[row, columns.message_base[e] + k] = arrival
            stale[rules.receiver[e]] = True
        if rules.frequency[n]:
            # An own overrun (computation longer than the period) shifts later ticks, waiting does not.
            tick = columns.tick_base[n] + k
            shift[n] += max(0, end - now - (columns.ticks[tick + 1] - columns.ticks[tick]))
        count[n] += 1
        known[n], stale[n] = False, True
        unknown += 1


@njit(cache=True)
def _let_go(n, rules, ready, known, held):
    """The step to run: node n's, the earliest known one, or one that is held and starts before it.

    Whoever is still unknown waits for a known step, so nothing that could arrive by then is to come.
    """
    first = -1
    for m in range(len(held)):
        if not held[m] or (n >= 0 and ready[m] >= ready[n]):
            continue
        if first < 0 or ready[m] < ready[first]:
            first = m
        elif ready[m] > ready[first]:
            continue
        elif rules.rank[m] < rules.rank[first]:
            first = m
    return n if first < 0 else first


@njit(cache=True)
def _measured_before_end(supervisor, rules, measured, ready, known, unknown):
    """The measured step that runs next at the instant of the end: all that were measured came before it."""
    n = supervisor
    for m in range(len(known)):
        if m == supervisor or not known[m] or not measured.node[m] or ready[m] != ready[supervisor]:
            continue
        if n == supervisor or _comes_first(m, n, rules, known, unknown):
            n = m
    return n


@njit(cache=True)
def _next_start(n, row, rules, columns, draws, measured, times, count, taken, shift, ready, known):
    """Rules 2 and 3: start of a node's next step, and whether all messages that it awaits have been sent.

    A step whose start was measured is held while a node that was not measured may still send what it awaited.
    """
    mine = measured.node[n]
    k = count[n]
    column = columns.step_base[n] + k
    tick = columns.ticks[columns.tick_base[n] + k]
    start = 0 if rules.unscheduled[n] else tick + shift[n]
    if k > 0:
        start = max(start, times.t_end[row, column - 1])
    for j in range(rules.into_base[n], rules.into_base[n + 1]):
        e = rules.into[j]
        if not rules.blocking[e]:
            continue
        # Wait for all messages that were nominally started since the last tick.
        s, base = rules.sender[e], columns.message_base[e]
        size = columns.step_base[s + 1] - columns.step_base[s]
        i = taken[e]
        while i < size:
            begun = columns.ticks[columns.tick_base[s] + i]
            if begun > tick or (rules.skip[e] and begun == tick):
                break
            if i >= count[s]:
                if not mine:
                    return start, _INCOMPLETE
                # A measured start did not wait for what arrived, or if lost was sent, after it.
                if measured.node[s]:
                    sent = measured.start[columns.step_base[s] + i]
                elif known[s]:
                    sent = ready[s]
                else:
                    return measured.start[column], _HELD
                sent += draws.values[row, draws.first[s] + i * draws.stride[s]]
                channel = len(rules.rank) + e
                way = draws.values[row, draws.first[channel] + i * draws.stride[channel]]
                if (sent + way if way < LOST else sent) <= measured.start[column]:
                    return measured.start[column], (_INCOMPLETE if measured.node[s] else _HELD)
                break
            # A lost message is waited for until it was sent: then nothing is to come, as far as is known.
            known_at = times.t_received[row, base + i]
            if known_at >= LOST:
                known_at = times.t_end[row, columns.step_base[s] + i]
            start = max(start, known_at)
            i += 1
        if i >= size and not measured.node[s]:
            return -1, _INCOMPLETE
    return (measured.start[column] if mine else start), _COMPLETE


@njit(cache=True)
def _comes_first(m, n, rules, known, unknown):
    """Whether of two steps at one instant that of m is to run before that of n."""
    waits_m, waits_n = False, False
    if unknown > 0:
        for a in range(len(rules.rank)):
            if not known[a]:
                waits_m |= rules.ancestor[m, a]
                waits_n |= rules.ancestor[n, a]
    if waits_m != waits_n:
        return waits_n
    return rules.rank[m] < rules.rank[n]


@njit(cache=True)
def _finish(row, channel, start, work, draws, stall):
    """Instant at which `work` ticks without any stall have passed since `start`; -1: stalls run out."""
    now, left = start, work
    while True:
        begin = LOST
        held = False
        for g in range(len(stall)):
            if not draws.stalled[g, channel]:
                continue
            j = stall[g]
            while j < draws.stall_end.shape[2] and draws.stall_end[row, g, j] <= now:
                j += 1
            if j == draws.stall_end.shape[2]:
                return -1
            if draws.stall_begin[row, g, j] <= now:
                now = draws.stall_end[row, g, j]
                held = True
                break
            begin = min(begin, draws.stall_begin[row, g, j])
        if held:
            continue
        if now + left <= begin:
            return now + left
        left -= begin - now
        now = begin


@njit(cache=True)
def _take_awaited(e, k, row, now, rules, columns, times, count, taken, seen, picked):
    """Rule 2: take all that were awaited and have arrived; a measured start may precede some of them."""
    s, base = rules.sender[e], columns.message_base[e]
    tick = columns.ticks[columns.tick_base[rules.receiver[e]] + k]
    i = taken[e]
    while i < count[s]:
        begun = columns.ticks[columns.tick_base[s] + i]
        if begun > tick or (rules.skip[e] and begun == tick):
            break
        if not picked[base + i] and times.t_received[row, base + i] <= now:
            _push(seen[e], rules.window[e], i)
            picked[base + i] = True
        i += 1
    _forget(e, row, base, i, times, taken, picked)


@njit(cache=True)
def _take_arrived(e, row, now, measured, rules, columns, times, count, taken, seen, picked):
    """Rule 5: take everything that has arrived, in the order of arrival."""
    s, base, nominal = rules.sender[e], columns.message_base[e], rules.nominal[e]
    in_order = rules.fifo[e] and not measured.edge[e]
    while True:
        best = -1
        for i in range(taken[e], count[s]):
            received = times.t_received[row, base + i]
            if picked[base + i] or received >= LOST:
                continue
            arrival = received
            if nominal >= 0:
                arrival = max(arrival, columns.ticks[columns.tick_base[s] + i] + nominal)
            if arrival > now or (rules.skip[e] and arrival == now):
                if in_order:
                    break
                continue
            if best < 0 or received < times.t_received[row, base + best]:
                best = i
            if in_order:
                break
        if best < 0:
            return
        picked[base + best] = True
        _push(seen[e], rules.window[e], best)
        _forget(e, row, base, count[s], times, taken, picked)


@njit(cache=True)
def _forget(e, row, base, sent, times, taken, picked):
    """Move on past the messages that were taken or got lost."""
    while taken[e] < sent and (picked[base + taken[e]] or times.t_received[row, base + taken[e]] >= LOST):
        taken[e] += 1


@njit(cache=True)
def _push(seen, size, message):
    for i in range(size - 1):
        seen[i] = seen[i + 1]
    seen[size - 1] = message
