"""A session at the robot: from the greeting to the moment when all nodes are closed again."""

import queue
import socket
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from deepkoco.graph.episodes.episode import Note
from deepkoco.graph.episodes.storage.container import EpisodeFileError
from deepkoco.graph.live.away import Away, Home
from deepkoco.graph.live.clocked import ClockedSchedule, clocked_schedule
from deepkoco.graph.live.crew import FAREWELL, Crew
from deepkoco.graph.live.crew_plan import CrewOptions
from deepkoco.graph.live.failure import Ending, NodeFailure, failure_of
from deepkoco.graph.live.measured import part_of_episode
from deepkoco.graph.live.message import Message, decode, encode
from deepkoco.graph.live.recorder import Recorder
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.net.clock_offset import Offset, SteadyCorrection
from deepkoco.graph.net.failure import LinkFailure
from deepkoco.graph.net.leader import failure_tree
from deepkoco.graph.net.link import Link
from deepkoco.graph.net.robot_options import RobotOptions
from deepkoco.graph.net.wire import Frame, Kind, WireError, pack, unpack

ENOUGH = 10  # exchanges before an episode begins
CLOCK_PATIENCE = 2.0  # what they may take [s]
_LOOK = 0.02  # between two looks at whether all is well [s]


class Session(Away):
    """Runs the robot's nodes by the orders of the end that leads.

    The clock of an episode is that of the end that leads: the correction of this machine's clock is set when nodes are
    reset, and follows slowly while they run.

    Args:
        graph: nodes and connections.
        options: where the nodes live.
        robot: silence and recording.
        connection: where the other end has said hello.
        name: of the other end, HOST:PORT.
        hello: what the other end said of itself.
        number: of the session, for the name of its recording.
    """

    def __init__(
        self,
        graph: Graph,
        options: CrewOptions,
        robot: RobotOptions,
        connection: socket.socket,
        name: str,
        hello: dict[str, Any],
        number: int,
    ) -> None:
        self.graph, self.nodes, self._options, self._silence = graph, options.away, options, robot.silence
        self.name = name
        self.meta = {
            "session": str(hello.get("session")),
            "end": "robot",
            "leader": self.name,
            "robot_nodes": sorted(set(graph.index) - self.nodes),
        }
        self._orders: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._crew: Home | None = None
        self._clock: SteadyCorrection | None = None
        self._running = False  # an episode, so that the clock must not jump
        self._wanted = False  # the end: it was asked for
        self._ending = threading.Lock()
        self._failure: NodeFailure | None = None
        self._origin: int | None = None  # of the episode [ns]
        self._episode = -1
        self._logs: dict[str, dict[str, Any]] = {}
        self._uncertain = 0  # the most, while an episode ran [ns]
        self._recording = None if robot.record is None else _free_name(Path(robot.record), number)
        self._recorder = None if self._recording is None else Recorder(graph, self._recording, self.meta)
        self._unwritten: EpisodeFileError | None = None
        self.link = Link(
            connection,
            self._take,
            self._lost,
            robot.silence,
            exchanged=self._exchanged,
            known=self._known,
        )

    # ------------------------------------------------------------- its life

    def run(self) -> None:
        """Open the nodes, obey until the end, close them."""
        self.link.start()
        crew = None
        try:
            crew = Crew(self.graph, self._options, self)
            if self._recorder is not None:
                seats = crew.seats
                self._recorder.listen(crew.reports, lambda: [(n, seat.driver) for n, seat in seats.items()])
            while crew.failure is None:
                try:
                    order = self._orders.get(timeout=_LOOK)
                except queue.Empty:
                    continue
                self._obey(crew, order)
        except NodeFailure:
            pass  # the crew has it, and has stopped
        except Exception as error:
            self.end(f"{type(error).__name__}: {error}")
        finally:
            if crew is not None:
                crew.stop()
                self._failure = crew.failure or self._failure or crew.unclosed
                self._end_recording(crew)
            self.link.close(FAREWELL)

    def end(self, reason: str) -> None:
        """Stop all; any thread may call it."""
        self._fail(LinkFailure(reason))

    def summary(self) -> str:
        """Say how it ended."""
        reason = "it was told to" if self._wanted or self._failure is None else self._failure.cause
        closed = {} if self._failure is None else self._failure.closed_after
        text = f"session ended: {reason}"
        if closed:
            text += f"; nodes closed within {max(0.0, *closed.values()) * 1e3:.1f} ms"
        if self._origin is not None and self._recording is not None:
            text += f"; recording: {self._recording}"
        if self._unwritten is not None:
            text += f"; not recorded any further: {self._unwritten}"
        return text

    # ------------------------------------------------- what the crew asks of it

    def start(self, crew: Home) -> None:
        self._clock = SteadyCorrection(crew.correction)
        self._crew = crew
        if self._failure is not None:
            crew.hear(-1, "failed", self._failure)

    def send(self, message: Message) -> None:
        self.link.send(Kind.MESSAGE, encode(message))

    def tell(self, position: int, command: str, payload: Any) -> None:
        raise WireError("orders come from the end that leads")

    def stop(self, failure: NodeFailure | None) -> None:
        self.link.watch(False)  # a long record may be on its way
        failure = failure or self._failure
        self.link.send(Kind.OVER, pack(failure_tree(None if self._wanted else failure)))

    def close(self) -> None:
        self.link.close()

    def farewell(self, records: dict[str, dict[str, Any]]) -> None:
        for name, record in records.items():
            self._answer(self.graph.index[name], "record", record)
        self._answer(-1, "parted", None)

    # ------------------------------------------------------- what comes

    def _take(self, one: Frame) -> None:
        """Take a frame, in the link's thread, which must not wait for a node."""
        if one.kind == Kind.MESSAGE:
            if self._crew is not None:
                self._crew.arrive(decode(one.body))
        elif one.kind == Kind.ORDER:
            self._orders.put(unpack(one.body))
        elif one.kind == Kind.OVER:
            reason = unpack(one.body).get("reason")
            self._wanted = reason is None
            self._fail(LinkFailure(f"{self.name} has stopped: {reason or 'it was told to'}"))
        else:
            raise WireError(f"a frame of kind {one.kind}")

    def _lost(self, reason: str) -> None:
        self._fail(LinkFailure(f"connection to {self.name}, which leads: {reason}"))

    def _fail(self, failure: NodeFailure) -> None:
        with self._ending:
            self._failure = self._failure or failure
            crew = self._crew
        if crew is not None:
            crew.hear(-1, "failed", failure)

    def _obey(self, crew: Crew, order: dict[str, Any]) -> None:
        position, command, payload = order["node"], order["command"], order["payload"]
        name = self.graph.nodes[position].name
        if name in self.nodes or command not in ("reset", "go", "end"):
            raise WireError(f'order "{command}" to node "{name}"')
        if command == "reset":
            self._settle()
            self._episode = payload["episode"]
            self._answer(position, command, crew.ask({name: (command, payload)})[name])
        elif command == "end":
            if not self._logs:
                # All at once: a node that ended later would miss the commands that do not come any more.
                own = (node for node in self.graph.index if node not in self.nodes)
                self._logs = crew.ask({node: (command, payload) for node in own})
                self._finish()
            self._answer(position, command, self._logs[name])
        else:
            self._begin(payload)
            crew.tell(name, command, payload | {"factor": 1.0, "part": self._schedule(name)})

    def _schedule(self, name: str) -> ClockedSchedule:
        """When a node runs; of what comes from the other end it must not go without for long."""
        schedule = clocked_schedule(self.graph, name, False, 0)
        inputs = tuple(
            replace(rule, silence=round((float(1 / rule.rate) + self._silence) * 1e9))
            if connection.sender in self.nodes
            else rule
            for rule, connection in zip(schedule.inputs, self.graph.inputs_of(name), strict=True)
        )
        return replace(schedule, inputs=inputs)

    def _answer(self, position: int, kind: str, payload: Any) -> None:
        self.link.send(Kind.ANSWER, pack({"node": position, "kind": kind, "payload": payload}))

    # ------------------------------------------------------- its clock

    def _settle(self) -> None:
        """Let the clock jump to what is known of the other one, before nodes start by it."""
        until = time.monotonic() + CLOCK_PATIENCE
        while self.link.offsets.count < ENOUGH and self.link.alive and time.monotonic() < until:
            time.sleep(_LOOK)
        estimate = self.link.offsets.estimate
        if self.link.offsets.count < ENOUGH or estimate is None:
            raise WireError("the other end does not answer the questions for its time")
        assert self._clock is not None
        self._running = False
        self._clock.set(estimate, time.monotonic_ns())

    def _exchanged(self, estimate: Offset, now: int) -> None:
        if self._clock is None:
            return
        if self._running:
            self._clock.follow(estimate, now)
            self._uncertain = max(self._uncertain, estimate.uncertainty)
        else:
            self._clock.set(estimate, now)

    def _known(self) -> tuple[int, int]:
        estimate = self.link.offsets.estimate
        return (0 if self._clock is None else self._clock.value), (
            0 if estimate is None else estimate.uncertainty
        )

    # ------------------------------------------------------- its recording

    def _begin(self, payload: dict[str, Any]) -> None:
        """Begin an episode with the order to go to its first node."""
        if payload["origin"] == self._origin:
            return
        self._origin, self._running, self._logs, self._uncertain = payload["origin"], True, {}, 0
        self.link.watch(True)
        if self._recorder is not None:
            self._guard(self._recorder.open)
            if self._unwritten is None:
                self._recorder.begin(self._episode, None, {}, payload["origin_ns"])

    def _finish(self) -> None:
        """Finish an episode whose nodes have all ended."""
        self._running = False
        self.link.watch(False)
        if self._recorder is not None:
            self._recorder.end(part_of_episode(self.graph, self._logs))

    def _end_recording(self, crew: Crew) -> None:
        if self._recorder is None:
            return
        part = ending = None
        if self._running and crew.records:
            part = part_of_episode(self.graph, crew.records)
            end = max((float(t[-1]) for t in part.t_end.values() if len(t)), default=0.0)
            failure = self._failure or failure_of("", -1, RuntimeError("it was told to"))
            ending = Ending(
                Note(end, "warning" if self._wanted else "fatal", failure.node, failure.cause), ""
            )
            if not self._wanted:
                ending = ending._replace(failure=failure.cause)
            part = ending.mark(part)
        recorder = self._recorder
        self._guard(lambda: recorder.close(part, ending))

    def _guard(self, write: Any) -> None:
        """Write; if the disk fails, the robot goes on and the summary tells."""
        try:
            write()
        except EpisodeFileError as error:
            self._unwritten = self._unwritten or error


def _free_name(folder: Path, number: int) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    while (path := folder / f"session_{number:04d}.mcap").exists() or path.with_name(
        f"{path.name}.partial"
    ).exists():
        number += 1
    return path
