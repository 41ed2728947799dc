"""The commands that a policy has sent, and which of them acts when."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from deepkoco.koopman.latent_model import Array

MOST_KEPT = 1024
"""Commands that are kept; older ones have acted, or never will."""


class SentCommands:
    """Commands with the times at which they begin to act, expected ones until they are known.

    A command acts from its arrival until a newer one arrives. One that arrives after a newer one is of no use to
    the receiver, which tells by its number, and never acts.
    """

    def __init__(self) -> None:
        """Start with nothing sent; `start` gives what acts before the first arrival."""
        self._commands: deque[Array] = deque(maxlen=MOST_KEPT)
        self._sent: deque[float] = deque(maxlen=MOST_KEPT)
        self._arrival: deque[float] = deque(maxlen=MOST_KEPT)
        self._known: deque[bool] = deque(maxlen=MOST_KEPT)
        self._first = np.zeros(0)
        self._total, self._count = 0.0, 0

    def start(self, action: Array) -> None:
        """Begin an episode in which this action (M,) acts until the first command arrives."""
        for kept in (self._commands, self._sent, self._arrival, self._known):
            kept.clear()
        self._first = action
        self._total, self._count = 0.0, 0

    @property
    def mean_delay(self) -> float | None:
        """Mean of the delays that have become known since the start; None before the first."""
        return self._total / self._count if self._count else None

    def send(self, command: Array, now: float, arrival: float) -> None:
        """Add a command (M,).

        Args:
            command: Its values.
            now: When it is sent, in any unit of time, not before the last one.
            arrival: When it is expected to act.
        """
        self._commands.append(command)
        self._sent.append(now)
        self._arrival.append(arrival)
        self._known.append(False)

    def measure(self, delays: Iterable[float], now: float) -> None:
        """Take in which delays are known.

        Args:
            delays: Time from sending to arrival of the last commands, newest first; infinite: not arrived yet.
            now: The time; what has not arrived is expected now at the earliest.
        """
        for back, delay in zip(range(1, len(self._sent) + 1), delays, strict=False):
            if math.isfinite(delay):
                self._arrival[-back] = self._sent[-back] + delay
                if not self._known[-back]:
                    self._known[-back] = True
                    self._total, self._count = self._total + delay, self._count + 1
            elif self._arrival[-back] < now:
                self._arrival[-back] = now

    def between(self, begin: float, end: float) -> tuple[Array, Array]:
        """Which action acts from one time to another.

        Args:
            begin: Start of the time.
            end: Its end; what arrives at the end counts.

        Returns:
            When the action changes (K,), increasing, in (begin, end]; and the action at the begin, then after each
            change (1 + K, M).
        """
        times: list[float] = []
        actions: list[Array] = []
        overtaken = float("inf")
        for command, arrival in zip(reversed(self._commands), reversed(self._arrival), strict=True):
            if arrival >= overtaken or arrival > end:
                continue
            overtaken = arrival
            actions.append(command)
            if arrival <= begin:
                break
            times.append(arrival)
        else:
            actions.append(self._first)
        return np.array(times[::-1]), np.array(actions[::-1])
