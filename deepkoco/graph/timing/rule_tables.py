"""Arrays of the timing rules: what they are, what is drawn and measured, and what they give."""

from typing import NamedTuple

import numpy as np


class Rules(NamedTuple):
    """What follows from the graph alone; N nodes, E connections.

    Attributes:
        supervisor: node whose step `steps` ends the episode.
        rank: (N,) place of each node in the topological order.
        ancestor: (N, N) bool, [n, m]: messages that are not skipped lead from m to n.
        frequency: (N,) bool, else phase scheduling.
        unscheduled: (N,) bool, starts as soon as its blocking inputs are there.
        sender, receiver, window: (E,).
        skip, blocking, fifo: (E,) bool.
        nominal: (E,) expected age of a message on arrival [ticks], or -1: taken as soon as it is there.
        into, into_base: connections into each node, (E,) and (N + 1,).
        out_of, out_base: connections out of each node, (E,) and (N + 1,).
    """

    supervisor: int
    rank: np.ndarray
    ancestor: np.ndarray
    frequency: np.ndarray
    unscheduled: np.ndarray
    sender: np.ndarray
    receiver: np.ndarray
    window: np.ndarray
    skip: np.ndarray
    blocking: np.ndarray
    fifo: np.ndarray
    nominal: np.ndarray
    into: np.ndarray
    into_base: np.ndarray
    out_of: np.ndarray
    out_base: np.ndarray


class Columns(NamedTuple):
    """Where steps, messages and windows lie (see `Layout`), and the nominal start of every step [ticks]."""

    step_base: np.ndarray
    message_base: np.ndarray
    window_base: np.ndarray
    tick_base: np.ndarray
    ticks: np.ndarray


class Draws(NamedTuple):
    """Delays of nodes and connections, in this order C = N + E channels [ticks].

    Attributes:
        values: (R, W); draw k of channel c is column first[c] + k stride[c].
        first, stride: (C,); stride 0: the same delay every time.
        stall_begin, stall_end: (R, G, S) of G stall processes.
        stalled: (G, C) bool, which process holds up which channel.
    """

    values: np.ndarray
    first: np.ndarray
    stride: np.ndarray
    stall_begin: np.ndarray
    stall_end: np.ndarray
    stalled: np.ndarray


class Measured(NamedTuple):
    """What was measured and is not worked out; the same in all schedules.

    Attributes:
        start: (steps of all nodes) measured starts [ticks]; `LOST` from where the record of a node ends. Empty:
            nothing was measured.
        node: (N,) bool, which nodes start when they were measured to start.
        edge: (E,) bool, of which connections the arrivals were measured.
    """

    start: np.ndarray
    node: np.ndarray
    edge: np.ndarray


class Times(NamedTuple):
    """What the rules give, as in `ComputationGraph`."""

    t_start: np.ndarray
    t_end: np.ndarray
    t_received: np.ndarray
    windows: np.ndarray
    boundary: np.ndarray
