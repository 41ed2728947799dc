"""The end that leads: the nodes at the robot as the runtime of this machine sees them."""

import secrets
import socket
import threading
from collections.abc import Mapping
from typing import Any

from deepkoco.graph.live.away import Away, Home
from deepkoco.graph.live.collection import exempt_present, include_again
from deepkoco.graph.live.crew import FAREWELL
from deepkoco.graph.live.failure import NodeFailure
from deepkoco.graph.live.message import Message, decode, encode
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.net.failure import ConnectionRefused, LinkFailure
from deepkoco.graph.net.greeting import PATIENCE, greet, split_address
from deepkoco.graph.net.link import SILENCE, Link
from deepkoco.graph.net.wire import Frame, Kind, WireError, pack, unpack

_SENT = (
    "initial_outputs",
    "origin",
    "origin_ns",
    "record",
)  # of the order to go: the rest each end knows itself


def connect(graph: Graph, address: str, silence: float = SILENCE) -> "RobotNodes":
    """Connect with the machine of a robot, where `deepkoco serve` or `RobotEnd` runs some nodes of the graph.

    This end leads: it has the supervisor and all nodes that the robot's machine has not, and its clock counts.

        with WallClockRuntime(graph, away=connect(graph, "192.168.0.7:7411"), record="run.mcap") as runtime:
            runtime.reset(parameters, generator)
            runtime.run(policy, 500)
            episode = runtime.finish()

    Args:
        graph: as at the robot; nodes that run there may be of other classes here.
        address: HOST:PORT.
        silence: longest time without anything from the robot [s].

    Returns:
        What `WallClockRuntime` takes as `away`.

    Raises:
        ConnectionRefused: nobody listens there, or it has another graph or version; the message says what to do.
    """
    return RobotNodes(graph, address, silence)


class RobotNodes(Away):
    """The nodes at the other end of a connection; see `connect`.

    After the connection has ended it is made anew by the next `reset` of a runtime, and by nothing else: no robot moves
    because a cable was plugged in again.

    Attributes:
        session: name of this run in the recordings of both ends.
        link: the connection.
    """

    def __init__(self, graph: Graph, address: str, silence: float) -> None:
        self.graph, self.name = graph, address
        self.session = secrets.token_hex(8)
        self._address, self._silence = split_address(address), silence
        self._crew: Home | None = None
        self._failure: NodeFailure | None = None
        self._parted = threading.Event()
        self._records: dict[str, dict[str, Any]] = {}
        self._connect()

    @property
    def meta(self) -> Mapping[str, Any]:
        return {
            "session": self.session,
            "end": "leader",
            "robot": self.name,
            "robot_nodes": sorted(self.nodes),
        }

    def start(self, crew: Home) -> None:
        if not self.link.alive:
            self._connect()
        self._crew = crew
        if self._failure is not None:
            self._fail(self._failure)

    def send(self, message: Message) -> None:
        self.link.send(Kind.MESSAGE, encode(message))

    def tell(self, position: int, command: str, payload: Any) -> None:
        if command in ("go", "end"):
            self.link.watch(command == "go")
        if command == "go":
            payload = {key: payload[key] for key in _SENT}
        self.link.send(Kind.ORDER, pack({"node": position, "command": command, "payload": payload}))

    def stop(self, failure: NodeFailure | None) -> None:
        self.link.watch(False)
        self.link.send(Kind.OVER, pack({"reason": None if failure is None else failure.reason}))

    def farewell(self, records: dict[str, dict[str, Any]]) -> None:
        received = -1
        # A long record takes its time; one that does not come any further is given up.
        while (
            self.link.alive
            and not self._parted.wait(FAREWELL)
            and self.link.counts.bytes_received > received + 1000
        ):
            received = self.link.counts.bytes_received
        records.update(self._records)
        self.close()

    def close(self) -> None:
        """End the connection; the robot stops if it has not yet."""
        self._crew = None
        self.link.close(0.5)
        include_again()

    def _connect(self) -> None:
        self._parted, self._records, self._failure = threading.Event(), {}, None
        exempt_present()
        try:
            connection = socket.create_connection(self._address, PATIENCE)
        except OSError as error:
            raise ConnectionRefused(
                f"{self.name}: {error.strerror or error}; start `deepkoco serve` there, and check address, port and "
                "firewall"
            ) from error
        try:
            content = greet(connection, self.graph, self.session)
        except OSError as error:
            connection.close()
            raise ConnectionRefused(f"{self.name}: {error.strerror or error}") from error
        except ConnectionRefused as error:
            connection.close()
            raise ConnectionRefused(f"{self.name}: {error}") from None
        self.nodes = frozenset(content["nodes"])
        self.link = Link(connection, self._take, self._lost, self._silence)
        self.link.start()

    def _take(self, one: Frame) -> None:
        crew = self._crew
        if one.kind == Kind.MESSAGE:
            if crew is not None:
                crew.arrive(decode(one.body))
            return
        tree = unpack(one.body)
        if one.kind == Kind.OVER:
            self.link.watch(False)
            self._fail(_failure_of(tree, self.name))
        elif one.kind != Kind.ANSWER:
            raise WireError(f"a frame of kind {one.kind}")
        elif tree["kind"] == "parted":
            self._parted.set()
        elif tree["kind"] == "record":
            self._records[self.graph.nodes[tree["node"]].name] = tree["payload"]
        elif crew is not None:
            crew.hear(tree["node"], tree["kind"], tree["payload"])

    def _lost(self, reason: str) -> None:
        self._fail(LinkFailure(f"connection to the robot at {self.name}: {reason}"))
        self._parted.set()

    def _fail(self, failure: NodeFailure) -> None:
        self._failure = self._failure or failure
        if self._crew is not None:
            self._crew.hear(-1, "failed", failure)


def _failure_of(tree: Mapping[str, Any], name: str) -> NodeFailure:
    if tree.get("failed_node"):
        return NodeFailure(
            tree["failed_node"], tree["tick"], f"(at {name}) {tree['reason']}", tree["details"]
        )
    return LinkFailure(f"the robot at {name} has stopped: {tree.get('reason') or 'it was told to'}")


def failure_tree(failure: NodeFailure | None) -> dict[str, Any]:
    """Describe for the other end why all is stopped here."""
    if failure is None:
        return {"reason": None}
    named = {"failed_node": failure.node, "tick": failure.tick, "details": failure.details}
    return {"reason": failure.reason} | (named if failure.node else {})


__all__ = ["RobotNodes", "connect", "failure_tree"]
