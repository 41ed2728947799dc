"""Drivers: when a node starts its next step and what it then sees; by a plan. `clocked` has the other one."""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from torch import Tensor

from deepkoco.graph.live.inbox import Inbox
from deepkoco.graph.live.message import Message
from deepkoco.graph.live.plan import NodePlan
from deepkoco.graph.live.runner import Runner
from deepkoco.graph.model.node import Input

AHEAD = 2  # supervisor steps that a node which needs no action may run ahead


class Outlet(NamedTuple):
    """Where the output of a node goes on one connection.

    Attributes:
        edge: number of the connection in the graph.
        send: passes a message on.
    """

    edge: int
    send: Callable[[Message], None]


class Driver(ABC):
    """Steps one node through one episode: `begin`, the node's own step, `finish`, again and again.

    Args:
        runner: the node.
        inbox: where its messages come.
        places: number of the graph's connection -> number of the node's input.
        outlets: where its output goes.
        origin: instant of time 0 [ns, monotonic].
        factor: simulated seconds per second; infinity does not wait for the clock.
        record: keep the outputs.
        correction: what is added to the own clock to have that of the episode, as its first entry [ns]: the machine
            that leads may be another one. None: its own.
    """

    def __init__(
        self,
        runner: Runner,
        inbox: Inbox,
        places: dict[int, int],
        outlets: list[Outlet],
        origin: int,
        factor: float,
        record: bool,
        correction: np.ndarray | None = None,
    ) -> None:
        self._correction = correction
        self.runner, self.inbox, self.places, self.outlets = runner, inbox, places, outlets
        self.origin, self.factor, self.record = origin, factor, record
        self.episode = inbox.episode
        self.tick = 0
        self.time = 0.0
        self.outputs: list[np.ndarray] = []
        self._reported = 0

    @abstractmethod
    def begin(self, until: int | None = None) -> dict[str, Input] | None:
        """Wait for the next step; return what it sees, or None where an order came or `until` is reached."""

    @abstractmethod
    def finish(self, output: Tensor) -> None:
        """Send the output of the step that `begin` began."""

    @abstractmethod
    def log(self) -> dict[str, Any]:
        """Return what was recorded, as plain arrays."""

    @abstractmethod
    def news(self) -> dict[str, Any] | None:
        """Return what was recorded since the last call; None if nothing was. For one thread besides the node's.

        Returns:
            `first`: number of the first step in it; `outputs`: (K, ...) of the K steps that ended since; where
            the clock decides, also all that `log` has of them, and the messages that came since as `received`.
        """

    def _keep(self, output: Tensor) -> None:
        if self.record:
            self.outputs.append(output[0].detach().cpu().numpy().copy())

    def _stacked(self, first: int, last: int) -> np.ndarray:
        """Outputs of some steps, (K, ...); one large array travels faster than many small ones."""
        outputs = self.outputs[first:last]
        return np.stack(outputs) if outputs else np.zeros(0)

    def _instant(self, time: float) -> int:
        """Turn a time of the episode [ns] into an instant [ns, monotonic]."""
        return self.origin + math.ceil(time / self.factor) - self._ahead()

    def _ahead(self) -> int:
        """How far the clock of the episode is ahead of this machine's [ns]."""
        return 0 if self._correction is None else int(self._correction[0])


class PlannedDriver(Driver):
    """Waits for the messages that the plan names, and for nothing else: the same result in every run.

    Args:
        plan: the node's part.
        steps: supervisor steps that the plan has; None: no end.
        follows: whether the node needs, directly or not, the supervisor's actions; one that does not would
            run ahead without end and therefore waits for credit.
    """

    def __init__(self, *args: Any, plan: NodePlan, steps: int | None, follows: bool) -> None:
        super().__init__(*args)
        self.plan, self.steps, self.follows = plan, steps, follows

    def begin(self, until: int | None = None) -> dict[str, Input] | None:
        try:
            planned = self.plan.step(self.tick) if until is None or self.tick < until else None
        except IndexError:  # the node has nothing more to do
            planned = None
        if planned is None:
            while until is None and not self.inbox.ordered():
                self.inbox.wait(messages=False)
            return None
        start = planned.t_start * 1e9
        while True:
            for message, _ in self.inbox.take()[1]:
                self.runner.put(self.places[message.edge], message.seq, message.data)
            if self.inbox.ordered():
                return None
            if self._held_back() or self.runner.missing(planned.windows):
                self.inbox.wait()
            elif self.factor < math.inf and time.monotonic_ns() < self._instant(start):
                self.inbox.wait(self._instant(start), messages=False)
            else:
                break
        seen = self.runner.look(planned.t_start, planned.windows)
        self.runner.drop_before(planned.oldest)
        self.time = planned.t_start
        return seen

    def finish(self, output: Tensor) -> None:
        self._keep(output)
        for outlet in self.outlets:
            outlet.send(Message(self.inbox.episode, outlet.edge, self.tick, 0, 0, output))
        self.tick += 1

    def log(self) -> dict[str, Any]:
        return {"outputs": self._stacked(0, self.tick)}

    def news(self) -> dict[str, Any] | None:
        first, self._reported = self._reported, len(self.outputs)
        if first == self._reported:
            return None
        return {"first": first, "outputs": self._stacked(first, self._reported)}

    def _held_back(self) -> bool:
        if self.follows:
            return False
        reach = self.inbox.credit + AHEAD
        return self.tick >= self.plan.limit(reach if self.steps is None else min(reach, self.steps))
