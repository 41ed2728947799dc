"""Two machines at 100 Hz for ten minutes, and what a killed end leaves behind.

    python -m experiments.studies.graph.two_machines --out results/graph/two_machines

Both ends run on this machine, connected by 127.0.0.1. Where the system permits it the robot's end gets a monotonic
clock that is a day ahead, so that the offset of the clocks is known exactly and is not zero.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from deepkoco.graph import Episode, Graph, read_episodes
from deepkoco.graph.live import NodeFailure, WallClockRuntime
from deepkoco.graph.net import connect, merge_recordings
from deepkoco.graph.net.clock_offset import Exchange, OffsetEstimator
from deepkoco.graph.net.graph_file import read_graph_file
from experiments.studies.graph.live_study import load, run_study
from experiments.studies.graph.two_machines_motor import FRAME, PORT
from experiments.studies.graph.two_machines_report import (
    DRIFT,
    clock_table,
    draw_clocks,
    draw_kills,
    report,
    tables,
)

if TYPE_CHECKING:
    from deepkoco.graph.drawing.style import Picture

ROOT = Path(__file__).parents[3]
RUN = str(ROOT / "docs/examples/two_machines.py")
MOTOR = str(Path(__file__).with_name("two_machines_motor.py"))
AHEAD = 86_400  # how far the robot's clock is ahead [s]
START = 120.0  # what a busy machine gets to start a process [s]
DRIFTED = 1234.5  # of the made-up clock of the second evaluation, beside its drift [s]
KILLS = (
    ("leader", "SIGKILL"),
    ("leader", "SIGKILL"),
    ("leader", "SIGKILL"),
    ("leader", "SIGKILL"),
    ("leader", "SIGSTOP"),
    ("leader", "SIGSTOP"),
    ("robot's end", "SIGKILL"),
    ("robot's end", "SIGKILL"),
    ("process of the motor", "SIGKILL"),
    ("process of the motor", "SIGKILL"),
)
"""What is killed how; SIGSTOP leaves the connection open and silent, as a cable that is pulled does."""


# ------------------------------------------------------------- both ends


@contextlib.contextmanager
def serving(
    file: str, nodes: str, folder: Path, priority: int | None, **environment: str
) -> Iterator[tuple[str, int, int]]:
    """A robot's end in a process of its own; gives its address, its process and how far its clock is ahead [ns]."""
    ahead = AHEAD if _time_namespaces() else 0
    prefix = ["unshare", "--time", "--monotonic", str(AHEAD), "--fork", "--kill-child"] if ahead else []
    command = [
        sys.executable,
        "-m",
        "deepkoco.cli",
        "serve",
        file,
        "--nodes",
        nodes,
        "--listen",
        "127.0.0.1:0",
    ]
    asked = [] if priority is None else ["--priority", str(priority)]
    log = folder / "serve.log"
    with log.open("w") as out:
        process = subprocess.Popen(
            [*prefix, *command, *asked, "--record", str(folder / "robot")],
            stdout=out,
            stderr=out,
            env=os.environ | environment,
            cwd=ROOT,
        )
    own = process.pid
    try:
        until = time.monotonic() + START
        while "waiting at" not in (text := log.read_text()):
            if process.poll() is not None or time.monotonic() > until:
                raise RuntimeError(f"the robot's end does not start: {text}")
            time.sleep(0.1)
        if prefix:
            own = int(Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()[0])
        yield text.split("waiting at ")[1].split(",")[0], own, ahead * 10**9
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(own, signal.SIGTERM)  # unshare itself takes no signals while its child lives
        process.wait()


def _time_namespaces() -> bool:
    if shutil.which("unshare") is None:
        return False
    tried = subprocess.run(["unshare", "--time", "--monotonic", "1", "--fork", "true"], capture_output=True)
    return tried.returncode == 0


# ------------------------------------------------------- the ten minutes


class Watched:
    """What the leading end saw of the clocks while it ran."""

    def __init__(self) -> None:
        self.exchanges: list[list[Exchange]] = []
        self.corrections: list[
            tuple[float, int, int]
        ] = []  # since the start [s], correction and uncertainty [ns]
        self.silences: list[float] = []


def long_run(
    seconds: float, folder: Path, priority: int | None = None
) -> tuple[Graph, list[Episode], list[tuple[str, Path]], Watched, int]:
    """Run until enough seconds have been recorded, in as many sessions as it takes.

    Returns:
        The graph; the episodes; by session why it ended and its recording; the clocks; how far the robot's is ahead.
    """
    file = read_graph_file(RUN)
    graph, policy, watched = file.graph, file.policy(), Watched()
    rate = float(graph.node(graph.supervisor).rate)
    episodes, sessions, left = [], [], round(seconds * rate)
    began = time.monotonic()
    with serving(RUN, "world,sensor", folder, priority) as (address, _, ahead):

        def look(inputs: Any) -> torch.Tensor:
            correction, uncertainty = away.link.far_correction
            watched.corrections.append((time.monotonic() - began, correction, uncertainty))
            return policy(inputs)

        while left > 0:
            record = folder / f"leader_{len(sessions):04d}.mcap"
            away = connect(graph, address)
            away.link.exchanges = []
            try:
                with WallClockRuntime(graph, away=away, record=record) as runtime:
                    runtime.reset(file.parameters(), torch.Generator().manual_seed(len(sessions)))
                    runtime.run(look, left)
                    episode, reason = runtime.finish(), "done"
            except NodeFailure as failure:
                reason = failure.cause
                time.sleep(1.0)  # until the robot's end has written its recording
                episode = merged(folder, record, len(sessions))
            watched.exchanges.append(away.link.exchanges)
            watched.silences.append(away.link.counts.longest_silence)
            sessions.append((reason, record))
            if episode is not None:
                episodes.append(episode)
                left -= len(episode.t_start[graph.supervisor]) - 1
            if len(sessions) > 60:
                raise RuntimeError(f"too many sessions: {sessions}")
    return graph, episodes, sessions, watched, ahead


def merged(folder: Path, record: Path, number: int) -> Episode | None:
    """Put the recordings of a session together that was cut off; None where it had not begun."""
    robot = folder / "robot" / f"session_{number:04d}.mcap"
    try:
        return read_episodes(merge_recordings(record, robot, record.with_suffix(".merged.mcap"))).episodes[0]
    except ValueError:
        return None


def drifting_offset(exchanges: list[list[Exchange]], ahead: int) -> np.ndarray:
    """Errors of the estimate and its uncertainty [ns], (K, 2), were the other clock fast and far ahead.

    The measured exchanges, with the far stamps as a clock would have given them that runs faster by `DRIFT`; so the
    truth is known at every instant.

    Args:
        exchanges: by session.
        ahead: how far the far clock really is [ns].
    """
    errors = []
    for session in exchanges:
        estimator, first = OffsetEstimator(), session[0].sent if session else 0

        def far(own: int, first: int = first) -> int:
            return own + round(DRIFTED * 1e9 + DRIFT * (own - first))

        for one in session:
            drifted = Exchange(
                one.sent, far(one.far_received - ahead), far(one.far_sent - ahead), one.received
            )
            estimate = estimator.add(drifted)
            if estimator.count > 10:
                errors.append((estimate.value - (far(one.received) - one.received), estimate.uncertainty))
    return np.array(errors)


# ------------------------------------------------------------- the kills


class Witness:
    """A drive that is told commands over a connection of its own, and writes down when each came."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.commands: list[tuple[float, float]] = []
        self.zero_at: float | None = None  # when the last command was taken back or the connection ended [s]
        self.process = 0
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        connection, _ = self._listener.accept()
        data = b""
        while piece := self._receive(connection):
            now, data = time.monotonic(), data + piece
            while len(data) >= FRAME.size:
                self.process, command = FRAME.unpack_from(data)
                data = data[FRAME.size :]
                self.commands.append((now, command))
                if command == 0.0 and self.moves:
                    self.zero_at = self.zero_at or now
        self.zero_at = self.zero_at or time.monotonic()

    @staticmethod
    def _receive(connection: socket.socket) -> bytes:
        try:
            return connection.recv(4096)
        except OSError:
            return b""

    @property
    def moves(self) -> bool:
        """Whether the motor has had power."""
        return any(command != 0.0 for _, command in self.commands)


def kill(what: str, how: str, rng: np.random.Generator, priority: int | None = None) -> dict[str, Any]:
    """Kill one part of a run and measure when the motor is without power."""
    witness = Witness()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        with serving(MOTOR, "motor", folder, priority, **{PORT: str(witness.port)}) as (address, robot, _):
            leader = subprocess.Popen(
                [sys.executable, "-m", "deepkoco.cli", "lead", MOTOR, "--to", address, "--seconds", "600"],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                cwd=ROOT,
            )
            try:
                until = time.monotonic() + START
                while not witness.moves and time.monotonic() < until and leader.poll() is None:
                    time.sleep(0.01)
                time.sleep(2.0 + float(rng.uniform(0.0, 0.05)))  # at any time within a period
                if witness.zero_at is not None or not witness.moves:
                    return {"killed": what, "signal": how, "stopped_before": True}
                pid = {"leader": leader.pid, "robot's end": robot}.get(what, witness.process)
                at = time.monotonic()
                os.kill(pid, getattr(signal, how))
                while witness.zero_at is None and time.monotonic() < at + 10.0:
                    time.sleep(0.001)
            finally:
                leader.kill()
                leader.wait()
    zero_at = float("nan") if witness.zero_at is None else witness.zero_at
    last = max(t for t, command in witness.commands if command != 0.0)
    return {
        "killed": what,
        "signal": how,
        "stopped_before": False,
        "zero_after_kill_ms": 1e3 * (zero_at - at),
        "zero_after_last_command_ms": 1e3 * (zero_at - last),
        "load_average": load(),
    }


# --------------------------------------------------------------- results


def study(arguments: argparse.Namespace) -> tuple[list[Picture], str]:
    """Kill first, then run long."""
    import pandas as pd

    from deepkoco.graph.drawing.style import Picture

    rng = np.random.default_rng(arguments.seed)
    rows = []
    for what, how in KILLS[: arguments.kills]:
        while (row := kill(what, how, rng, arguments.priority))["stopped_before"]:
            rows.append(row | {"load_average": load()})
        rows.append(row)
        print(row, flush=True)
    with tempfile.TemporaryDirectory() as place:
        processor = os.times()
        graph, episodes, sessions, watched, ahead = long_run(
            arguments.seconds, Path(place), arguments.priority
        )
        used = sum(os.times()[:4]) - sum(processor[:4])
    nodes, messages = tables(graph, episodes)
    clocks = clock_table(watched.corrections, ahead)
    stops = [reason for reason, _ in sessions]
    pictures = [
        Picture("clocks", draw_clocks(clocks), clocks.iloc[:: max(1, len(clocks) // 3000), :]),
        Picture("kills", draw_kills(rows), pd.DataFrame(rows)),
    ]
    drifted = drifting_offset(watched.exchanges, ahead)
    text = report(
        arguments, nodes, messages, clocks, stops, rows, drifted, max(watched.silences), ahead, used
    )
    return pictures, text


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; return the exit status."""
    assert __doc__
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/graph/two_machines"))
    parser.add_argument("--seconds", type=float, default=600.0, help="length of the run [s]")
    parser.add_argument("--kills", type=int, default=len(KILLS), help="how many of the kills")
    parser.add_argument("--seed", type=int, default=0, help="of the instants of the kills")
    parser.add_argument(
        "--priority", type=int, help="real-time priority of the nodes at the robot (default: none)"
    )
    return run_study(argv, parser, study)


if __name__ == "__main__":
    sys.exit(main())
