"""Control of a unit at a fixed rate, with the timing that was really reached."""

from __future__ import annotations

from dataclasses import dataclass

from deepkoco.unit.messages import SensorMessage
from deepkoco.unit.process import Unit
from deepkoco.unit.simulated import SimulatedUnit

LONGEST_SLACK = 2e-3  # [s]


@dataclass
class ControlStats:
    """Timing of the control steps since the last reset.

    Attributes:
        steps: Steps done.
        overruns: Steps that were asked for after their own end; the schedule then skips ticks.
        mean_period: Mean time from the return of one step to the return of the next [s].
        longest_period: Longest such time [s].
        lost: Samples of the sensor that never came.
        stops: Times that the unit stopped itself for lack of a command.
    """

    steps: int = 0
    overruns: int = 0
    mean_period: float = 0.0
    longest_period: float = 0.0
    lost: int = 0
    stops: int = 0


class ControlLoop:
    """Control ticks on an absolute schedule: send the command, wait for the tick, read the sensor.

    A tick comes a little after the sample it is to see (a quarter of the sensor's period, at most 2 ms),
    so that the last measurement at a tick is not a matter of luck.

    Args:
        unit: Running unit, of either clock.
        rate: Control rate [Hz].
    """

    def __init__(self, unit: Unit | SimulatedUnit, rate: float) -> None:
        if not rate > 0.0:
            raise ValueError(f"control rate {rate} Hz is not positive")
        self.unit = unit
        self.rate = rate
        self.stats = ControlStats()
        self._slack = min(LONGEST_SLACK, 0.25 / unit.spec.sensor.rate_hz)
        self._latest: SensorMessage | None = None

    def reset(self, state: tuple[float, float] | None = None) -> SensorMessage:
        """Put the unit into a state (angle [rad], speed [rad/s]) and start the schedule.

        Returns:
            First measurement.
        """
        self._latest = self.unit.reset(state)
        self.stats = ControlStats()
        self._origin = self.unit.now() + self._slack
        self._tick = 0
        self._returned = self.unit.now()
        return self._latest

    def step(self, command: float) -> SensorMessage:
        """Send a command and wait for the next control tick.

        Args:
            command: In the command's unit.

        Returns:
            Latest measurement at the tick; the one before it where none has come since.

        Raises:
            UnitError: The unit has died.
            RuntimeError: The loop has not been reset.
        """
        self.send(command)
        return self.wait()

    def send(self, command: float) -> None:
        """First half of :meth:`step`: several units are stepped at once by sending to all, then waiting."""
        if self._latest is None:
            raise RuntimeError("step before reset: call reset first")
        sent = self.unit.send(command)
        self._tick += 1
        if sent > self._due:
            self.stats.overruns += 1
            self._tick = int((sent - self._origin) * self.rate) + 1

    def wait(self) -> SensorMessage:
        """Second half of :meth:`step`."""
        if self._latest is None:
            raise RuntimeError("step before reset: call reset first")
        # Past the tick, the messages that are there already still count.
        while (message := self.unit.poll(max(0.0, self._due - self.unit.now()))) is not None:
            self._take(message)
        now = self.unit.now()
        stats = self.stats
        stats.longest_period = max(stats.longest_period, now - self._returned)
        stats.mean_period += (now - self._returned - stats.mean_period) / (stats.steps + 1)
        stats.steps += 1
        self._returned = now
        return self._latest

    @property
    def _due(self) -> float:
        return self._origin + self._tick / self.rate

    def _take(self, message: SensorMessage) -> None:
        assert self._latest is not None
        self.stats.lost += message.seq - self._latest.seq - 1
        self.stats.stops = message.stops
        self._latest = message
