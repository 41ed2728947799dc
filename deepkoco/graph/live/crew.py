"""The crew: all nodes of a graph in their threads and processes, watched over and stopped together."""

import atexit
import queue
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing import Pipe as pipe_pair
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection as Pipe
from multiprocessing.connection import wait
from threading import Event, Lock, Thread, current_thread
from typing import Any

import numpy as np

from deepkoco.graph.live.away import Away
from deepkoco.graph.live.crew_plan import AWAY, HERE, CrewOptions, CrewPlan
from deepkoco.graph.live.failure import NodeFailure, failure_of
from deepkoco.graph.live.host import BEAT_PERIOD, HostPlan, Line, close_seats, make_seats, serve
from deepkoco.graph.live.inbox import Inbox, Order
from deepkoco.graph.live.message import Message, decode
from deepkoco.graph.live.seat import BEAT, BUSY_SINCE, CLOSED_AT, TICK, Seat, step_limit
from deepkoco.graph.model.graph import Graph

FAREWELL = 5.0  # what a process gets to end after it was told to [s]


class Crew:
    """Starts the nodes, passes orders to them, watches them, stops them all when one fails.

    Args:
        graph: nodes and connections; the supervisor stays with the caller.
        options: where the nodes live and when they have failed.
        away: the way to those on another machine; None: there are none.

    Raises:
        GraphError: a node does not travel to its process.
    """

    def __init__(self, graph: Graph, options: CrewOptions, away: Away | None = None) -> None:
        self.graph, self.options, self._away = graph, options, away
        self._plan = CrewPlan(graph, options)
        self.hosts = self._plan.hosts
        self.supervisor_inbox = Inbox()
        self.failure: NodeFailure | None = None
        self.unclosed: NodeFailure | None = None  # the first node that did not close, after `stop`
        self.priority_granted: bool | None = None
        self.records: dict[str, dict[str, Any]] = {}  # by node name, after `stop`
        self._stopping, self._stopped, self._over = Lock(), False, Event()
        self._noticed = 0  # when the failure was [ns, monotonic]
        self._replies: queue.SimpleQueue[tuple[int, str, Any]] = queue.SimpleQueue()
        self._failures: queue.SimpleQueue[NodeFailure] = queue.SimpleQueue()
        self._heard, self._bell = pipe_pair(False)
        self._start(self._plan.host_plans())
        atexit.register(self.stop)  # a caller who forgets to close must not leave a motor running
        if away is not None:
            try:
                away.start(self)
            except BaseException:
                self.stop()
                raise

    def tell(self, name: str, command: str, payload: Any = None) -> None:
        """Give a node an order."""
        position, host = self.graph.index[name], self.hosts[name]
        if host == AWAY:
            assert self._away is not None
            self._away.tell(position, command, payload)
        elif host != HERE:
            self._controls[host].tell(position, command, payload)
        elif command == "credit":
            self.seats[position].inbox.grant(payload)
        else:
            self.seats[position].inbox.order(Order(command, payload))

    def ask(self, orders: Mapping[str, tuple[str, Any]]) -> dict[str, Any]:
        """Give orders by node name, and wait for an answer to each; the answer bears the name of the order.

        Raises:
            NodeFailure: a node has failed.
        """
        if self.failure is not None:
            raise self.failure
        for name, (command, payload) in orders.items():
            self.tell(name, command, payload)
        answers: dict[str, Any] = {}
        while len(answers) < len(orders):
            position, kind, payload = self._replies.get()
            if self.failure is not None:
                raise self.failure
            name = self.graph.nodes[position].name
            if name in orders and kind == orders[name][0]:
                answers[name] = payload
        return answers

    def outlets_of(self, name: str) -> list[tuple[int, Callable[..., None]]]:
        """Return number and way of each connection on which the caller's node sends."""
        ways = []
        for edge, connection in enumerate(self.graph.connections):
            if connection.sender != name:
                continue
            host = self.hosts[connection.receiver]
            if connection.receiver == self.graph.supervisor:
                ways.append((edge, self.supervisor_inbox.deliver))
            elif host == AWAY:
                assert self._away is not None
                ways.append((edge, self._away.send))
            elif host == HERE:
                ways.append((edge, self.seats[self._plan.receivers[edge]].inbox.deliver))
            else:
                ways.append((edge, self._lines[host].send))
        return ways

    @property
    def correction(self) -> np.ndarray:
        """What all nodes here add to the clock of this machine to have that of the episode, (1,) int64 [ns]."""
        return self._board[-1, :1]

    def arrive(self, message: Message) -> None:
        """Pass on an output that has come from another machine."""
        receiver = self._plan.receivers[message.edge]
        host = self.hosts[self.graph.nodes[receiver].name]
        if host > HERE:
            self._lines[host].send(message)
        elif host == HERE:
            self._deliver(message)

    def hear(self, position: int, kind: str, payload: Any) -> None:
        """Take what a node on another machine, or who watches the way there, has to say; as for `Seat`."""
        self._reply(position, kind, payload)

    def fail(self, failure: NodeFailure) -> None:
        """Note the first failure, order the supervisor to stop, then stop all others."""
        if self.failure is not None or self._stopped:
            return
        self._noticed = time.monotonic_ns()
        self.failure = failure
        # The caller must not act while the others are closed: a process that hangs takes seconds to end.
        self.supervisor_inbox.order(Order("stop"))
        self._replies.put((-1, "failed", None))
        self.stop()

    def stop(self) -> None:
        """Close every node, end every process, keep what was recorded.

        Safe to call twice: the second call waits for the first one.
        """
        with self._stopping:
            first, self._stopped = not self._stopped, True
        if first:
            try:
                self._stop()
            finally:
                self._over.set()
        elif current_thread() is not self._watch:
            self._over.wait()

    def _stop(self) -> None:
        for line in self._controls.values():
            line.tell(-1, "stop", None)
        if self._away is not None:
            self._away.stop(self.failure)
        close_seats(self.seats)
        atexit.unregister(self.stop)
        if current_thread() is not self._watch:
            self._watch.join()
        for position, seat in self.seats.items():
            self._keep(position, seat.record())
        self._bury()
        for thread in self._post:
            thread.join(FAREWELL)
        if self._away is not None:
            self._away.farewell(self.records)
        lines = (*self._controls.values(), *self._lines.values())
        for pipe in (self._heard, self._bell, *(line.pipe for line in lines)):
            pipe.close()
        self._check_closed()

    def _check_closed(self) -> None:
        """Note when each node was closed after a failure, and which was not."""
        for name in self.hosts:
            row = self._board[self.graph.index[name]]
            if name == self.graph.supervisor or self.hosts[name] == AWAY:
                continue
            if closed := int(row[CLOSED_AT]):
                if self.failure is not None:
                    self.failure.closed_after[name] = (closed - self._noticed) / 1e9
            elif self.unclosed is None:
                process = self._processes.get(self.hosts[name])
                ended = (
                    "" if process is None else f" before its process ended (exit status {process.exitcode})"
                )
                self.unclosed = NodeFailure(name, int(row[TICK]), f"was not closed{ended}")

    def _bury(self) -> None:
        """Take the last words of the processes, until they have ended or their time is over."""
        now = time.monotonic_ns()
        for name, host in self.hosts.items():
            beat = int(self._board[self.graph.index[name], BEAT])
            if beat and now - beat > self.options.beat_limit * 1e9:
                self._processes[host].kill()  # it stands still and will not say anything
        deadline = time.monotonic() + FAREWELL
        open_: set[Any] = {line.pipe for line in self._controls.values()}
        while open_ and (left := deadline - time.monotonic()) > 0:
            for source in wait(list(open_), left):
                pipe: Any = source
                try:
                    position, kind, payload = pipe.recv()
                    if kind == "record":
                        self._keep(position, payload)
                        deadline = time.monotonic() + FAREWELL  # a long record takes its time
                    elif kind == "unclosed":
                        self.unclosed = self.unclosed or payload
                except (EOFError, OSError):
                    open_.discard(pipe)
        for process in self._processes.values():
            process.join(max(0.0, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()

    def _keep(self, position: int, record: dict[str, Any] | None) -> None:
        if record is not None:
            self.records[self.graph.nodes[position].name] = record

    # ---------------------------------------------------------------- start

    def _start(self, plans: Mapping[int, HostPlan]) -> None:
        remote = sorted(set(plans) - {HERE})
        # A server that has the package loaded forks the processes: quick, and without the caller's threads.
        context: Any = get_context("forkserver" if "forkserver" in get_all_start_methods() else "spawn")
        context.set_forkserver_preload(["deepkoco.graph.live.host"])
        shape = len(self.graph.nodes) + 1, 4  # a row for each node, and one for the clock
        board = context.RawArray("q", shape[0] * shape[1])
        self._board = np.frombuffer(board, dtype=np.int64).reshape(shape)
        ends: dict[int, dict[int, Pipe]] = {host: {} for host in (HERE, *remote)}
        for one, other in self._plan.pairs():
            ends[one][other], ends[other][one] = _pipe(context)
        self._lines = {host: Line(pipe) for host, pipe in ends[HERE].items()}
        self._controls, self._processes = {}, {}
        self.reports: list[Pipe] = []  # what the nodes of the processes record, for who reads and closes them
        self.seats: dict[int, Seat] = {}  # of the caller's process
        try:
            for host in remote:
                here, there = _pipe(context)
                self._controls[host] = Line(here)
                report = self._report_pipe(context)
                process = context.Process(
                    target=serve, args=(plans[host], there, ends[host], board, shape, report), daemon=True
                )
                process.start()
                self._processes[host] = process
                there.close()
                if report is not None:
                    report.close()
        finally:
            for host in remote:
                for pipe in ends[host].values():
                    pipe.close()
        supervisor = self.graph.index[self.graph.supervisor]
        if HERE in plans:
            others = {supervisor: self.supervisor_inbox.deliver}
            if self._away is not None:
                others |= dict.fromkeys(
                    (self.graph.index[name] for name in self._away.nodes), self._away.send
                )
            self.seats = make_seats(
                plans[HERE].seats, self._plan.own_node, HERE, self._lines, self._board, self._reply, others
            )
        for seat in self.seats.values():
            seat.start()
        # A thread of their own reads the messages: a process that stands still in the middle of one holds up the
        # reader, and the watch must not stand still with it.
        self._post = [
            Thread(target=self._run_post, args=(line.pipe,), name=f"messages of process {host}", daemon=True)
            for host, line in self._lines.items()
        ]
        self._watch = Thread(target=self._run_watch, name="watch over nodes", daemon=True)
        for thread in (*self._post, self._watch):
            thread.start()

    def _report_pipe(self, context: Any) -> Pipe | None:
        """Keep the end that is read, return the one that a process writes to."""
        if not self.options.report:
            return None
        reader, writer = context.Pipe(duplex=False)
        self.reports.append(reader)
        return writer

    # ---------------------------------------------------------------- watch

    def _reply(self, position: int, kind: str, payload: Any) -> None:
        if kind == "failed":
            # The failing thread must not stop itself: the watch does.
            self._failures.put(payload)
            with suppress(OSError):
                self._bell.send_bytes(b"!")
        elif kind == "unclosed":
            self.unclosed = self.unclosed or payload
        else:
            self._replies.put((position, kind, payload))

    def _run_watch(self) -> None:
        controls = {line.pipe: host for host, line in self._controls.items()}
        sentinels = {process.sentinel: host for host, process in self._processes.items()}
        sources: list[Any] = [self._heard, *controls, *sentinels]
        while not self._stopped:
            try:
                for source in wait(sources, BEAT_PERIOD):
                    if source in sentinels:
                        host = sentinels[source]
                        self._read(self._controls[host].pipe)
                        self._mourn(host)
                        sources.remove(source)
                    elif not self._read(source):
                        sources.remove(source)
                while not self._failures.empty():
                    self.fail(self._failures.get())
                self._check_times(time.monotonic_ns())
            except Exception as error:
                # Without the watch nobody would notice anything; where all is stopped, pipes are closed.
                self.fail(failure_of(self.graph.supervisor, -1, error, traceback.format_exc()))

    def _run_post(self, pipe: Pipe) -> None:
        """Deliver the messages of one process to the nodes of the caller's, until all is stopped or it has ended."""
        try:
            while not self._stopped:
                if pipe.poll(BEAT_PERIOD):
                    self._deliver(decode(pipe.recv_bytes()))
        except (EOFError, OSError):
            return  # of the end of a process the watch knows
        except Exception as error:
            failure = failure_of(self.graph.supervisor, -1, error, traceback.format_exc())
            self._reply(self.graph.index[self.graph.supervisor], "failed", failure)

    def _read(self, source: Any) -> bool:
        """Read what a pipe holds; return whether it is still open."""
        try:
            while source.poll():
                if source is self._heard:
                    source.recv_bytes()
                else:
                    position, kind, payload = source.recv()
                    if kind == "priority":
                        self.priority_granted = payload
                    elif kind == "record":
                        self._keep(position, payload)
                    elif position >= 0:
                        self._reply(position, kind, payload)
        except (EOFError, OSError):
            return False
        return True

    def _deliver(self, message: Message) -> None:
        receiver = self._plan.receivers[message.edge]
        if self.hosts[self.graph.nodes[receiver].name] == AWAY:
            assert self._away is not None
            self._away.send(message)
            return
        seat = self.seats.get(receiver)
        (self.supervisor_inbox if seat is None else seat.inbox).deliver(message)

    def _mourn(self, host: int) -> None:
        """A process has ended without being told to."""
        while not self._failures.empty():
            self.fail(self._failures.get())
        process = self._processes[host]
        process.join(0)
        self.fail(self._blame(host, f"its process has died (exit status {process.exitcode})"))

    def _blame(self, host: int, reason: str) -> NodeFailure:
        """Name the node of a host that is in its own code; if none is, the first."""
        own = [self.graph.index[name] for name, where in self.hosts.items() if where == host]
        busy = [n for n in own if self._board[n, BUSY_SINCE]] or own
        return NodeFailure(self.graph.nodes[busy[0]].name, int(self._board[busy[0], TICK]), reason)

    def _check_times(self, now: int) -> None:
        for name, host in self.hosts.items():
            row = self._board[self.graph.index[name]]
            tick, since, beat = int(row[TICK]), int(row[BUSY_SINCE]), int(row[BEAT])
            limit = step_limit(self.options.time_limit, tick)
            if since and now - since > limit * 1e9:
                self.fail(NodeFailure(name, tick, f"has not returned for {limit:g} s"))
            elif beat and now - beat > self.options.beat_limit * 1e9:
                self.fail(self._blame(host, f"its process shows no life for {self.options.beat_limit:g} s"))


def _pipe(context: Any) -> tuple[Pipe, Pipe]:
    """Both ends of a pipe that goes both ways."""
    return context.Pipe()
