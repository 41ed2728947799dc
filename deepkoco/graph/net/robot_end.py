"""The robot's end: it waits for who leads, runs its nodes for one session, and leaves them safe."""

import errno
import os
import select
import socket
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from deepkoco.graph.episodes.storage.container import EpisodeFileError
from deepkoco.graph.live.collection import exempt_present, include_again
from deepkoco.graph.live.crew_plan import CrewOptions
from deepkoco.graph.live.wallclock import own_processes
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError
from deepkoco.graph.net.failure import ConnectionRefused
from deepkoco.graph.net.greeting import hear, refuse, split_address, welcome
from deepkoco.graph.net.robot_options import RobotOptions
from deepkoco.graph.net.session import Session

_LOOK = 0.1  # between two looks at who else wants to connect [s]


class RobotEnd:
    """Runs some nodes of a graph for whoever connects, one after the other.

        with RobotEnd(graph, ["world", "sensor"], "0.0.0.0:7411") as end:
            end.serve()

    A session begins with a connection and ends with it. Then, and where a node fails, where nothing comes for too
    long or where a clock jumps, all nodes are closed, and the robot waits for the next connection at rest. Who was
    connected does not get the robot back by being there again: it connects and resets anew.

    There is no password: whoever reaches the port moves the robot. Listen on 127.0.0.1 and reach it through a tunnel,
    or on a network of your own.

    Args:
        graph: as at the end that leads.
        nodes: those that run here; not the supervisor.
        address: HOST:PORT to listen on; port 0 takes a free one.
        options: how they run.
        say: is told in words what happens.

    Raises:
        GraphError: a name is no node, or that of the supervisor.
        EpisodeFileError: the folder of the recordings cannot be made or written to.
        ConnectionRefused: the address cannot be listened on; the message says why.
    """

    def __init__(
        self,
        graph: Graph,
        nodes: Sequence[str],
        address: str = "127.0.0.1:7411",
        options: RobotOptions | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        for name in nodes:
            if name not in graph.index:
                raise GraphError(f'"{name}" is no node; known: {", ".join(graph.index)}')
            if name == graph.supervisor:
                raise GraphError(f'supervisor "{name}" stays at the end that leads')
        if not nodes:
            raise GraphError(f"no node is to run here; known: {', '.join(graph.index)}")
        self.graph, self.nodes, self.options, self._say = (
            graph,
            frozenset(nodes),
            options or RobotOptions(),
            say,
        )
        self._others = frozenset(graph.index) - self.nodes
        hosts, cores = own_processes(
            graph, self.options.threads, self._others | {graph.supervisor}, self.options.pin
        )
        self.crew_options = CrewOptions(
            hosts,
            self.options.factories,
            self.options.time_limit,
            self.options.beat_limit,
            cores,
            self.options.priority,
            self.options.record is not None,
            self._others,
        )
        if self.options.record is not None:
            _prepare(Path(self.options.record))
        self._listener = _listen(address)
        self._ended = threading.Event()
        self._sessions = 0

    @property
    def address(self) -> str:
        """Where it listens, HOST:PORT."""
        host, port = self._listener.getsockname()[:2]
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    def __enter__(self) -> "RobotEnd":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop the session, if there is one, and listen no more; any thread may call it, and twice."""
        self._ended.set()

    def serve(self, sessions: int | None = None) -> None:
        """Wait for who leads, and run the nodes for it; again and again until `close`.

        Args:
            sessions: how many at most; None: without end.
        """
        exempt_present()
        try:
            self._say(f"waiting at {self.address}, nodes at rest: {', '.join(sorted(self.nodes))}")
            while not self._ended.is_set() and (sessions is None or self._sessions < sessions):
                if (session := self._next_session()) is not None:
                    self._sessions += 1
                    self._run(session)
        finally:
            self._listener.close()
            include_again()

    def _next_session(self) -> Session | None:
        """Accept who connects and fits, if anybody does soon."""
        if not select.select([self._listener], [], [], _LOOK)[0]:
            return None
        if (accepted := self._accept()) is None:
            return None
        connection, peer = accepted
        try:
            hello = hear(connection, self.graph)
            session = Session(
                self.graph, self.crew_options, self.options, connection, peer, hello, self._sessions
            )
            connection.settimeout(_LOOK)
            welcome(connection, nodes=sorted(self.nodes))
        except Exception as error:  # whoever connects, the robot goes on to wait for the next one
            self._say(f"{peer} refused: {error}")
            with suppress(OSError):
                if not isinstance(error, ConnectionRefused):  # else it has been told, or is none of ours
                    connection.settimeout(_LOOK)
                    refuse(connection, f"the robot's end cannot begin a session: {error}")
            connection.close()
            return None
        self._say(f"{peer} leads")
        return session

    def _accept(self) -> tuple[socket.socket, str] | None:
        """Accept who connects; return the connection and a name for it, None where it is gone already."""
        try:
            connection, peer = self._listener.accept()
        except OSError as error:
            self._say(f"a connection cannot be accepted: {error.strerror or error}")
            self._ended.wait(_LOOK)
            return None
        return connection, f"{peer[0]}:{peer[1]}"

    def _run(self, session: Session) -> None:
        thread = threading.Thread(target=session.run, name="session", daemon=True)
        thread.start()
        try:
            while thread.is_alive():
                self._refuse_others()
                if self._ended.is_set():
                    session.end("the robot's end was stopped")
                thread.join(_LOOK)
        except BaseException:  # Ctrl-C: first the robot
            session.end("the robot's end was interrupted")
            thread.join()
            raise
        finally:
            self._say(session.summary())

    def _refuse_others(self) -> None:
        if select.select([self._listener], [], [], 0.0)[0]:
            if (accepted := self._accept()) is None:
                return
            connection, peer = accepted
            self._say(f"{peer} refused: a session is running")
            with suppress(OSError):
                connection.settimeout(_LOOK)
                refuse(connection, "another machine leads this robot already; end that session first")
            connection.close()


def _prepare(folder: Path) -> None:
    """Make the folder of the recordings: who finds out only when a leader is there has a robot and no record."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EpisodeFileError(
            f"{folder}: the folder of the recordings cannot be made: {error.strerror or error}"
        ) from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise EpisodeFileError(f"{folder}: the folder of the recordings cannot be written to")


def _listen(address: str) -> socket.socket:
    host, port = split_address(address)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=4)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ConnectionRefused(
                f"{address}: the port is in use; end the other program (`ss -tlnp | grep {port}` names it), or take "
                "another port"
            ) from error
        raise ConnectionRefused(f"{address}: cannot be listened on: {error.strerror or error}") from error
