"""The thread in which a node lives: it opens, steps and closes it, and tells when it failed."""

import time
import traceback
from collections.abc import Callable, Mapping
from threading import Event, Lock, Thread
from typing import Any

import numpy as np
import torch

from deepkoco.graph.live.clocked import ClockedDriver, ClockedSchedule
from deepkoco.graph.live.driver import Driver, Outlet, PlannedDriver
from deepkoco.graph.live.failure import NodeFailure, failure_of
from deepkoco.graph.live.inbox import Inbox
from deepkoco.graph.live.runner import InitialStateError, Runner
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.node import Node

START_LIMIT = 60.0  # longest time that `open` and `init` of a node take [s]
CLOSE_LIMIT = 5.0  # longest time that is waited for `close` of a node [s]
TICK, BUSY_SINCE, CLOSED_AT, BEAT = range(4)
"""Columns of the board, int64: current tick, since when it steps (0: waits), when it was closed, heartbeat [ns]."""


class Seat(Thread):
    """Runs one node by the orders in its inbox.

    Args:
        position: number of the node in the graph.
        make: gives the node.
        name: its name.
        inputs: its connections.
        places: number of the graph's connection -> number of the input.
        outlets: where its output goes.
        board: (N, 4) int64, shared with who watches; see the constants above.
        reply: takes (position, kind, payload): "reset", "end", "failed" and "unclosed" with a `NodeFailure`, "closed".
        time_limit: longest step [s].
        correction: as for `Driver`, shared with who keeps it.
    """

    def __init__(
        self,
        position: int,
        make: Callable[[], Node],
        name: str,
        inputs: tuple[Connection, ...],
        places: dict[int, int],
        outlets: list[Outlet],
        board: np.ndarray,
        reply: Callable[[int, str, Any], None],
        time_limit: float,
        correction: np.ndarray | None = None,
    ) -> None:
        super().__init__(name=f"node {name}", daemon=True)
        self._correction = correction
        self.position, self.node_name, self._time_limit = position, name, time_limit
        self._make, self._inputs, self._places = make, inputs, places
        self._outlets, self._board, self._reply = outlets, board[position], reply
        self.inbox = Inbox()
        self._node: Node | None = None
        self.driver: Driver | None = None
        self._closing, self._closed = Lock(), Event()
        self._board[TICK] = -1

    def run(self) -> None:
        """Live until the order to stop, or until the node fails."""
        failure: NodeFailure | None = None
        try:
            with self._busy(-1):
                self._node = self._make()
                self._node.open()
            self._reply(self.position, "opened", None)
            self._serve(Runner(self._node, self._inputs))
        except BaseException as error:  # also SystemExit: whatever ends the node ends the graph
            tick = int(self._board[TICK])
            failure = failure_of(self.node_name, tick, error, traceback.format_exc())
        if failure is not None:
            self._reply(self.position, "failed", failure)
        self.close_node()

    def close_node(self) -> None:
        """Close the node, once, from whichever thread comes first: its own, or the one that has given it up.

        The second one waits until the node is closed, at most `CLOSE_LIMIT`.
        """
        if not self._closing.acquire(blocking=False):
            self._closed.wait(CLOSE_LIMIT)
            return
        try:
            if self._node is not None:
                self._node.close()
        except BaseException as error:
            failed = NodeFailure(
                self.node_name,
                int(self._board[TICK]),
                f"close raised {type(error).__name__}: {error}",
                traceback.format_exc(),
            )
            self._reply(self.position, "unclosed", failed)
        self._board[CLOSED_AT] = time.monotonic_ns()
        self._closed.set()
        self._reply(self.position, "closed", None)

    @property
    def busy(self) -> bool:
        """Whether the node is in its own code: it opens, starts an episode or steps."""
        return bool(self._board[BUSY_SINCE])

    def record(self) -> dict[str, Any] | None:
        """Return what the node's episode has recorded so far; None where it has none."""
        return None if self.driver is None else self.driver.log()

    def _serve(self, runner: Runner) -> None:
        while (order := self.inbox.next_order()).command != "stop":
            if order.command == "reset":
                self.driver = None
                self._reply(self.position, "reset", self._reset(runner, order.payload))
            elif order.command == "go":
                self.driver = make_driver(
                    runner, self.inbox, self._places, self._outlets, order.payload, self._correction
                )
                self._drive(self.driver, None)
            elif order.command == "end" and self.driver is not None:
                self._drive(self.driver, order.payload)
                with self._busy(self.driver.tick):
                    runner.node.rest()
                self._reply(self.position, "end", self.driver.log())

    def _reset(self, runner: Runner, payload: Mapping[str, Any]) -> dict[str, Any]:
        self.inbox.begin(payload["episode"])
        with self._busy(-1):
            try:
                return reset_runner(runner, payload)
            except InitialStateError as error:  # a mistake of the caller, not of the node
                return {"error": str(error)}

    def _drive(self, driver: Driver, until: int | None) -> None:
        while (seen := driver.begin(until)) is not None:
            with self._busy(driver.tick):
                output = driver.runner.step(seen)
                self._check_duration(driver.tick)
                driver.finish(output)

    def _busy(self, tick: int) -> "_Busy":
        return _Busy(self._board, tick)

    def _check_duration(self, tick: int) -> None:
        """Fail where a step came back late: one that holds the interpreter lock stops the watch as well."""
        passed = (time.monotonic_ns() - int(self._board[BUSY_SINCE])) / 1e9
        if passed > self._time_limit:
            reason = f"has returned after {passed:.3g} s, and may take {self._time_limit:g} s"
            raise NodeFailure(self.node_name, tick, reason)


class _Busy:
    """Writes on the board since when a node is in its own code, for who watches over it."""

    def __init__(self, board: np.ndarray, tick: int) -> None:
        self._board, self._tick = board, tick

    def __enter__(self) -> None:
        self._board[TICK] = self._tick
        self._board[BUSY_SINCE] = time.monotonic_ns()

    def __exit__(self, *error: object) -> None:
        self._board[BUSY_SINCE] = 0


def step_limit(time_limit: float, tick: int) -> float:
    """Return how long a node may be in its own code at a tick [s]; to open and `init` (tick -1) may take longer."""
    return time_limit if tick >= 0 else max(time_limit, START_LIMIT)


def reset_runner(runner: Runner, payload: Mapping[str, Any]) -> dict[str, Any]:
    """Start an episode of a runner with plain arrays; return its initial output and the generator's state."""
    generator = torch.Generator()
    generator.set_state(torch.from_numpy(payload["generator"].copy()))
    tensors = {
        part: {key: torch.from_numpy(np.array(value)) for key, value in payload[part].items()}
        for part in ("parameters", "initial")
    }
    output = runner.reset(tensors["parameters"], generator, tensors["initial"])
    return {"output": output.detach().cpu().numpy().copy(), "generator": generator.get_state().numpy()}


def make_driver(
    runner: Runner,
    inbox: Inbox,
    places: dict[int, int],
    outlets: list[Outlet],
    payload: Mapping[str, Any],
    correction: np.ndarray | None = None,
) -> Driver:
    """Make the driver of an episode from what "go" says."""
    runner.begin([torch.from_numpy(np.array(output)) for output in payload["initial_outputs"]])
    times = payload["origin"], payload["factor"], payload["record"], correction
    common = runner, inbox, places, outlets, *times
    part = payload["part"]
    if isinstance(part, ClockedSchedule):
        return ClockedDriver(*common, schedule=part)
    return PlannedDriver(*common, plan=part, steps=payload["steps"], follows=payload["follows"])
