"""Delays that depend on time alone, so that they are known before anything runs."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from deepkoco.graph.delay.law import Delay, DelayError, Stream, register, seconds


@register
@dataclass(frozen=True)
class Scheduled(Delay):
    """A delay that is a function of time: what starts at time t takes d(t).

    d is linear between the points (`times`, `delays`), and constant before the first and after the last. Two points
    with one time are a jump. Time is that of the episode; t is the nominal time at which a computation starts or a
    message is sent: phase + k / rate, and for a message the expected computation delay more. The delay does not
    know of overruns, because it is drawn before they are.

    Attributes:
        times: Never decreasing [s].
        delays: At these times [s].
    """

    times: tuple[float, ...]
    delays: tuple[float, ...]
    law = "scheduled"
    timed: ClassVar[bool] = True

    def __post_init__(self) -> None:
        try:
            times = np.asarray(self.times, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise DelayError(f"scheduled: times {self.times!r} are no numbers of seconds") from error
        delays = [seconds("delays", delay) for delay in np.ravel(np.asarray(self.delays, dtype=object))]
        if times.ndim != 1 or not len(times) or len(times) != len(delays):
            raise DelayError(
                f"scheduled: {times.size} times and {len(delays)} delays; give one delay for each time"
            )
        if not np.isfinite(times).all() or (np.diff(times) < 0.0).any():
            raise DelayError("scheduled: times must be finite and must not decrease")
        object.__setattr__(self, "times", tuple(times.tolist()))
        object.__setattr__(self, "delays", tuple(delays))

    @property
    def mean(self) -> float:
        """Expected delay: the mean over the time of the table [s]."""
        length = self.times[-1] - self.times[0]
        if length == 0.0:
            return math.fsum(self.delays) / len(self.delays)
        return float(np.trapezoid(self.delays, self.times)) / length

    @property
    def highest(self) -> float:
        return max(self.delays)

    @property
    def constant(self) -> bool:
        return min(self.delays) == max(self.delays)

    def at(self, time: ArrayLike) -> np.ndarray:
        """Return the delay [s] of what starts at each `time` [s]; at a jump, that after it."""
        time = np.asarray(time, dtype=np.float64)
        times, delays = np.array(self.times), np.array(self.delays)
        after = np.searchsorted(times, time, side="right")
        before = np.clip(after - 1, 0, len(times) - 1)
        after = np.minimum(after, len(times) - 1)
        span = times[after] - times[before]
        share = np.where(span > 0.0, (time - times[before]) / np.where(span > 0.0, span, 1.0), 0.0)
        # One product of a convex mean: where both ends agree, the delay is theirs to the last bit.
        return delays[before] + np.clip(share, 0.0, 1.0) * (delays[after] - delays[before])

    def cdf(self, delay: np.ndarray) -> np.ndarray:
        """Return the share of the time of the table in which the delay is at most `delay` [s]."""
        limit = np.asarray(delay, dtype=np.float64)[..., None]
        length = np.diff(self.times)
        if length.sum() == 0.0:
            return (limit >= np.array(self.delays)).mean(-1)
        low, high = (
            np.minimum(self.delays[:-1], self.delays[1:]),
            np.maximum(self.delays[:-1], self.delays[1:]),
        )
        flat = high == low
        share = np.where(
            flat, limit >= low, np.clip((limit - low) / np.where(flat, 1.0, high - low), 0.0, 1.0)
        )
        return (share * length).sum(-1) / length.sum()

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Return delays at random times of the table."""
        return self.at(self.times[0] + (self.times[-1] - self.times[0]) * generator.random(shape))

    def stream(self, rows: int, period: float, start: float = 0.0) -> Stream:
        return _ScheduledStream(self, rows, period, start)

    def to_dict(self) -> dict[str, Any]:
        return {"law": self.law, "times": list(self.times), "delays": list(self.delays)}


class _ScheduledStream(Stream):
    """The delays at the nominal times, one after the other; all rows have the same."""

    def __init__(self, law: Scheduled, rows: int, period: float, start: float) -> None:
        super().__init__(law, rows)
        self._table, self._period, self._start, self._next = law, period, start, 0

    def draw(self, generator: np.random.Generator, columns: int) -> np.ndarray:
        time = self._start + self._period * np.arange(self._next, self._next + columns)
        self._next += columns
        return np.tile(self._table.at(time), (self.rows, 1))


def transport_delay(times: ArrayLike, flow: ArrayLike, volume: float) -> Scheduled:
    """Return the delay of what enters a pipe, for a flow that is known beforehand.

    What enters at t leaves at t + d(t), when the flow has swept the volume of the pipe (plug flow):

        integral of the flow from t to t + d(t) = volume.

    flow[i] holds from times[i] to times[i + 1], the last one for ever. The swept volume is then piecewise linear, and
    so is d: the table is exact from times[0] on.

    Args:
        times: (n,) increasing [s].
        flow: (n,) never negative, the last above 0 [m3/s].
        volume: Of the pipe, above 0 [m3].

    Raises:
        DelayError: A flow, a time or the volume is not as above.
    """
    try:
        start, rate = np.asarray(times, dtype=np.float64), np.asarray(flow, dtype=np.float64)
        volume = float(volume)
    except (TypeError, ValueError) as error:
        raise DelayError(f"transport_delay: give numbers: {error}") from error
    if not np.isfinite(start).all():
        raise DelayError("transport_delay: times must be finite")
    if start.ndim != 1 or start.shape != rate.shape or not len(start) or (np.diff(start) <= 0.0).any():
        raise DelayError("transport_delay: give one flow for each of the times, which must increase")
    if not (np.isfinite(rate).all() and (rate >= 0.0).all() and rate[-1] > 0.0):
        raise DelayError(
            "transport_delay: flows must be finite and >= 0, the last above 0: else fluid never leaves"
        )
    if not (math.isfinite(volume) and volume > 0.0):
        raise DelayError(f"transport_delay: the volume {volume} of the pipe is not above 0")
    swept = np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(start))])
    end = start[-1] + volume / rate[-1]
    # d bends where the flow changes at the inlet, and at the entry of what leaves when it changes. A pipe that stands
    # still has one swept volume at two times: what enters meanwhile leaves at one time, and at its outlet d jumps.
    points = list(zip(start, _times_at(swept + volume, swept, start, rate[-1], "left"), strict=True))
    for leaves, level in zip([*start, end], [*(swept - volume), swept[-1]], strict=True):
        if level >= 0.0:
            for side in ("left", "right"):
                enters = _times_at(np.array([level]), swept, start, rate[-1], side)[0]
                points.append((enters, leaves))
    points = sorted(dict.fromkeys((float(enters), float(leaves)) for enters, leaves in points))
    return Scheduled(
        tuple(enters for enters, _ in points), tuple(leaves - enters for enters, leaves in points)
    )


def _times_at(level: np.ndarray, swept: np.ndarray, times: np.ndarray, last: float, side: str) -> np.ndarray:
    """Times [s] at which the swept volume first ("left") or last ("right") is at each level of at least 0."""
    if side == "left":
        place = np.maximum(np.searchsorted(swept, level, side="left") - 1, 0)
    else:
        place = np.searchsorted(swept, level, side="right") - 1
    rate = np.append(np.diff(swept) / np.diff(times), last)[place]
    return times[place] + np.where(rate > 0.0, (level - swept[place]) / np.where(rate > 0.0, rate, 1.0), 0.0)
