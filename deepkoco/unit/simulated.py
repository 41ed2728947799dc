"""A unit in virtual time: the same physics and the same interface, as fast as it computes."""

from __future__ import annotations

import math
from collections import deque
from random import Random
from types import TracebackType

from deepkoco.unit.messages import SensorMessage, UnitError
from deepkoco.unit.plant import Plant
from deepkoco.unit.spec import UnitSpec


class SimulatedUnit:
    """Stand-in for :class:`deepkoco.unit.process.Unit` whose clock moves only while the client waits.

    The client computes in no time and messages take no time beyond the unit's own delays, so a log is
    exact and the same for the same seed, to the byte.

    Args:
        spec: The unit.
        timeout: Longest wait for an answer, in virtual time [s].
    """

    clock = "simulated"

    def __init__(self, spec: UnitSpec, timeout: float = 2.0) -> None:
        self.spec = spec
        self.timeout = timeout
        self._stream = 0
        self._start(None)

    def __enter__(self) -> SimulatedUnit:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def now(self) -> float:
        """Virtual time since the last reset [s]."""
        return self._plant.time

    def send(self, command: float) -> float:
        """Send a command now and return the time [s].

        Raises:
            ValueError: The command is not finite.
        """
        if not math.isfinite(command):
            raise ValueError(f"command {command} is not finite")
        self._plant.send(command)
        return self._plant.time

    def receive(self, timeout: float | None = None) -> SensorMessage:
        """Move time on to the next measurement.

        Raises:
            UnitError: None comes within ``timeout`` [s].
        """
        limit = self.timeout if timeout is None else timeout
        message = self.poll(limit)
        if message is None:
            raise UnitError(f'unit "{self.spec.name}" sends no measurement within {limit:g} s')
        return message

    def poll(self, timeout: float) -> SensorMessage | None:
        """As :meth:`receive`, but None after ``timeout`` [s] without a measurement."""
        plant, deadline = self._plant, self._plant.time + timeout
        while not self._received:
            sample = self._tick / self.spec.sensor.rate_hz
            event = min(sample, plant.next_departure)
            if event > deadline:
                plant.advance(deadline)
                return None
            plant.advance(event)
            if sample <= plant.time:
                plant.sample(self._tick)
                self._tick += 1
            for seq, values in plant.take():
                self._received.append(SensorMessage(values, seq, plant.time, plant.stops))
        return self._received.popleft()

    def seed_noise(self, seed: int) -> None:
        """Let noise and jitter of the next resets follow from a seed, not from how many there were."""
        self._stream = Random(f"stream {seed}").getrandbits(62)

    def reset(self, state: tuple[float, float] | None = None) -> SensorMessage:
        """Put the unit into a state, at zero command and time 0; returns the first measurement.

        Raises:
            ValueError: The state is not finite.
        """
        start = None if state is None else (float(state[0]), float(state[1]))
        if start is not None and not (math.isfinite(start[0]) and math.isfinite(start[1])):
            raise ValueError(f"state ({start[0]}, {start[1]}) is not finite")
        self._stream += 1
        self._start(start)
        return self.receive()

    def close(self) -> None:
        """Stop the unit."""
        self._plant.stop()

    def _start(self, state: tuple[float, float] | None) -> None:
        self._plant = Plant(self.spec, state, stream=self._stream)
        self._received: deque[SensorMessage] = deque()
        self._tick = 0
