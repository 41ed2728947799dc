"""A motor at one end and who leads it at the other, with a cable between them that can be cut."""

import contextlib
import select
import socket
import threading
import time
from pathlib import Path

import torch

from deepkoco.graph import Connection, Graph, Node, Supervisor
from deepkoco.graph.live import WallClockRuntime
from deepkoco.graph.net import RobotEnd, RobotOptions, connect

AMPLE = 60.0  # limit [s] that nothing healthy exceeds, however busy the machine is


class Motor(Node):
    """Holds the command that it sees; leaves a mark with the time when it opens, first moves and closes."""

    pure = False

    def __init__(self, name, rate, folder, fault_at=None):
        super().__init__(name, rate)
        self.folder, self.fault_at = str(folder), fault_at
        self.ticks = 0

    def open(self):
        self._mark("open")

    def init(self, parameters, generator, batch):
        self.ticks = 0
        return {}

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1, dtype=torch.float64)

    def step(self, parameters, state, inputs):
        if self.ticks == self.fault_at:
            raise ValueError("encoder cable is off")
        command = inputs["agent"].data[:, -1]
        if float(command) != 0.0 and not self.ticks:
            self._mark("moves")
        self.ticks += 1
        return state, command.clone()

    def rest(self):
        self._mark("rest")

    def close(self):
        self._mark("close")

    def _mark(self, what):
        with (Path(self.folder) / f"{self.name}.{what}").open("a") as file:
            file.write(f"{time.monotonic()}\n")


def marks(folder, what, name="motor") -> list[float]:
    file = Path(folder) / f"{name}.{what}"
    return [float(line) for line in file.read_text().splitlines()] if file.exists() else []


def motor_graph(folder, rate=100, fault_at=None) -> Graph:
    """A motor at the robot, a filter with whoever leads, an agent."""
    return Graph(
        [
            Motor("motor", rate, folder, fault_at),
            Supervisor("agent", rate, initial_action=torch.zeros(1, dtype=torch.float64)),
        ],
        [Connection("motor", "agent", 0.001), Connection("agent", "motor", 0.001, skip=True)],
    )


def push(inputs) -> torch.Tensor:
    """A policy that always pushes, and counts what it has seen."""
    return 1.0 + 0.001 * inputs["motor"].seq[:, -1:].to(torch.float64).clamp(min=0)


class Serving:
    """A robot's end in a thread, whose nodes are threads of this process."""

    def __init__(self, graph, nodes, sessions=1, **options):
        self.said: list[str] = []
        options = {
            "threads": tuple(nodes),
            "silence": AMPLE,
            "time_limit": AMPLE,
            "beat_limit": AMPLE,
        } | options
        self.end = RobotEnd(graph, nodes, "127.0.0.1:0", RobotOptions(**options), self.said.append)
        self.address = self.end.address
        self.thread = threading.Thread(target=self.end.serve, args=(sessions,), daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.end.close()
        self.thread.join(AMPLE)
        assert not self.thread.is_alive()


class Cable:
    """A relay on 127.0.0.1 that passes everything on until it is cut; then nothing comes, and nothing is closed."""

    def __init__(self, address):
        host, port = address.split(":")
        self.target, self.cut_at = (host, int(port)), None
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()

    def cut(self):
        self.cut_at = time.monotonic()

    def mend(self):
        self.cut_at = None

    def _run(self):
        pairs: dict[socket.socket, socket.socket] = {}
        while not self._over.is_set():
            for source in select.select([self._listener, *pairs], [], [], 0.01)[0]:
                if source is self._listener:
                    near, far = self._listener.accept()[0], socket.create_connection(self.target)
                    pairs |= {near: far, far: near}
                elif self.cut_at is not None:
                    time.sleep(0.001)
                elif source in pairs:
                    try:
                        data = source.recv(1 << 16)
                    except OSError:
                        data = b""
                    with contextlib.suppress(OSError):
                        pairs[source].sendall(data) if data else pairs[source].shutdown(socket.SHUT_WR)
                    if not data:
                        del pairs[source]
        for each in {self._listener, *pairs, *pairs.values()}:
            each.close()


def leading(graph, address, silence=AMPLE, **options) -> WallClockRuntime:
    """A runtime that leads; nodes that the robot has not are threads."""
    away = connect(graph, address, silence)
    own = [name for name in graph.index if name != graph.supervisor and name not in away.nodes]
    return WallClockRuntime(graph, threads=own, time_limit=AMPLE, beat_limit=AMPLE, away=away, **options)
