"""A process that hosts nodes: it passes on what comes, shows that it lives, and closes its nodes at the end."""

import gc
import os
import pickle
import signal
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection as Pipe
from multiprocessing.connection import wait
from threading import Lock
from typing import Any

import numpy as np
import torch

from deepkoco.graph.live.driver import Outlet
from deepkoco.graph.live.inbox import Order
from deepkoco.graph.live.message import Message, decode, encode
from deepkoco.graph.live.reporter import Reporter
from deepkoco.graph.live.seat import BEAT, Seat
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.node import Node

BEAT_PERIOD = 0.02  # [s]
PATIENCE = 0.03  # what a node gets to end its step before it is closed from outside [s]
SLOW_TURN = 2.0  # what a node that is in no step gets, whose thread waits for a processor [s]
TURN = 0.005  # at most this long each of them is waited for at once [s]


@dataclass(frozen=True)
class SeatPlan:
    """A node of a host, in a form that travels.

    Attributes:
        position, name: number and name in the graph.
        node: the pickled function that makes the node, or the pickled node; empty in the caller's process.
        inputs: its connections.
        places: number of the graph's connection -> number of the input.
        outlets: connections on which it sends: number, host and node that receive.
        time_limit: longest step [s].
    """

    position: int
    name: str
    node: bytes
    inputs: tuple[Connection, ...]
    places: dict[int, int]
    outlets: tuple[tuple[int, int, int], ...]
    time_limit: float


@dataclass(frozen=True)
class HostPlan:
    """What a host needs to know.

    Attributes:
        index: its number.
        seats: its nodes.
        core: the core that it is pinned to; None: any.
        priority: real-time priority that it asks for; None: none.
        receivers: number of every connection of the graph -> node that receives.
    """

    index: int
    seats: tuple[SeatPlan, ...]
    core: int | None
    priority: int | None
    receivers: tuple[int, ...]


class Line:
    """A pipe on which several threads send."""

    def __init__(self, pipe: Pipe) -> None:
        self.pipe, self._lock = pipe, Lock()

    def send(self, message: Message) -> None:
        """Send an output; who is gone needs it no more."""
        frame = encode(message)
        with self._lock, suppress(OSError):
            self.pipe.send_bytes(frame)

    def tell(self, *words: Any) -> None:
        """Send an order or an answer."""
        with self._lock, suppress(OSError):
            self.pipe.send(words)


def make_seats(
    plans: tuple[SeatPlan, ...],
    make: Callable[[SeatPlan], Node],
    host: int,
    lines: Mapping[int, Line],
    board: np.ndarray,
    reply: Callable[[int, str, Any], None],
    others: Mapping[int, Callable[[Message], None]] | None = None,
) -> dict[int, Seat]:
    """Make the threads of a host's nodes, connected to each other and to the other hosts.

    Args:
        plans: the nodes.
        make: gives a node, in its own thread.
        host: number of this host.
        lines: by number of the host, the way there.
        board: as for `Seat`, with one row more, whose first entry is the correction of the clock (see `Driver`).
        reply: as for `Seat`.
        others: by number of the node, receivers of this host that are no seats: the supervisor, and nodes on another
            machine.
    """
    outlets: dict[int, list[Outlet]] = {plan.position: [] for plan in plans}
    seats = {}
    for plan in plans:
        seats[plan.position] = Seat(
            plan.position,
            partial(make, plan),
            plan.name,
            plan.inputs,
            plan.places,
            outlets[plan.position],
            board,
            reply,
            plan.time_limit,
            board[-1],
        )
    deliver = {position: seat.inbox.deliver for position, seat in seats.items()} | dict(others or {})
    for plan in plans:
        for edge, target, node in plan.outlets:
            send = deliver[node] if target == host else lines[target].send
            outlets[plan.position].append(Outlet(edge, send))
    return seats


def unpack(plan: SeatPlan) -> Node:
    """Make the node of a plan from what the starting process has packed."""
    made = pickle.loads(plan.node)
    return made if isinstance(made, Node) else made()


def serve(
    plan: HostPlan,
    control: Pipe,
    pipes: Mapping[int, Pipe],
    board: Any,
    shape: tuple[int, ...],
    report: Pipe | None,
) -> None:
    """Run a host; the main function of its process.

    Args:
        plan: its nodes.
        control: orders come in, answers go out.
        pipes: by number of the host, messages from and to it.
        board: shared memory, int64.
        shape: of the board.
        report: what the nodes record goes out while they run; None: only at the end.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the caller takes Ctrl-C and stops all
    ended: list[int] = []
    take_endings(lambda number: ended.append(number))
    torch.set_num_threads(1)
    gc.freeze()  # a full collection of what the fork brought would hold the nodes up for 0.1 s
    if plan.core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {plan.core})
    answers = Line(control)
    if plan.priority is not None:
        answers.tell(-1, "priority", _ask_priority(plan.priority))
    table = np.frombuffer(board, dtype=np.int64).reshape(shape)
    lines = {host: Line(pipe) for host, pipe in pipes.items()}
    seats = make_seats(plan.seats, unpack, plan.index, lines, table, answers.tell)
    for seat in seats.values():
        seat.start()
    if report is not None:
        Reporter(seats, report).start()
    sources: list[Any] = [control, *pipes.values()]
    stopped = False
    while not stopped and not ended:
        table[list(seats), BEAT] = time.monotonic_ns()
        for source in wait(sources, BEAT_PERIOD):
            assert isinstance(source, Pipe)
            try:
                if source is control:
                    stopped |= _obey(seats, source.recv())
                else:
                    message = decode(source.recv_bytes())
                    seats[plan.receivers[message.edge]].inbox.deliver(message)
            except (EOFError, OSError):
                # The caller is gone, or another host; of the latter the caller knows.
                sources.remove(source)
                stopped |= source is control
    close_seats(seats)
    for position, seat in seats.items():
        answers.tell(position, "record", seat.record())
    if any(seat.is_alive() for seat in seats.values()):
        os._exit(1)  # a step that does not return must not hold up the end


def take_endings(end: Callable[[int], object]) -> None:
    """Let what asks a process to end (SIGTERM), and its terminal that closes (SIGHUP), close its nodes first.

    Args:
        end: is called with the signal, in the main thread, and must not wait.
    """
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # What `nohup` started is to outlive its terminal.
        if number is not None and not (name == "SIGHUP" and signal.getsignal(number) is signal.SIG_IGN):
            signal.signal(number, lambda number, _: end(number))


def close_seats(seats: Mapping[int, Seat]) -> None:
    """Let the nodes end their steps and close; close those that do not end.

    A node in its own code gets `PATIENCE` to return. One that is not only waits for its turn on a busy machine; it
    closes in its own thread.
    """
    for seat in seats.values():
        seat.inbox.order(Order("stop"))
    began = time.monotonic()
    waiting = [seat for seat in seats.values() if seat.ident is not None]
    while waiting:
        for seat in waiting:
            seat.join(TURN)
        passed = time.monotonic() - began
        waiting = [seat for seat in waiting if seat.is_alive()]
        for seat in [s for s in waiting if passed > (PATIENCE if s.busy else SLOW_TURN)]:
            seat.close_node()
            waiting.remove(seat)
    for seat in seats.values():
        seat.close_node()


def _obey(seats: Mapping[int, Seat], words: tuple[Any, ...]) -> bool:
    """Pass an order on; return whether it is the last one."""
    position, command, payload = words
    if command == "stop":
        return True
    if command == "credit":
        seats[position].inbox.grant(payload)
    else:
        seats[position].inbox.order(Order(command, payload))
    return False


def _ask_priority(priority: int) -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, OSError):
        return False
    return True
