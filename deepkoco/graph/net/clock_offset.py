"""How far another machine's clock is ahead, from stamped questions and answers."""

import math
from collections import deque
from typing import NamedTuple

from deepkoco.graph.net.wire import WireError

DRIFT = 1e-4
"""How much faster than each other two clocks may run: quartz keeps 5e-5, and NTP bends less than that in the mean."""
KEPT = 128  # exchanges that are looked at
SMALL = 1_000_000  # a contradiction up to this is a clock that is bent for a while [ns]


class Exchange(NamedTuple):
    """A question and its answer [ns]; the first and last stamp are of the own clock, the others of the far one."""

    sent: int
    far_received: int
    far_sent: int
    received: int

    @property
    def round_trip(self) -> int:
        """Time that both ways took together [ns]."""
        return (self.received - self.sent) - (self.far_sent - self.far_received)


class Offset(NamedTuple):
    """How far the other clock is ahead.

    Attributes:
        value: the middle of what is possible [ns].
        uncertainty: the true one is at most this far away [ns].
        round_trip: of the last exchange [ns].
    """

    value: int
    uncertainty: int
    round_trip: int


class ClockJumpError(RuntimeError):
    """One of the clocks has jumped: what was known of them a moment ago cannot be true any more."""


class OffsetEstimator:
    """Bounds the offset theta = far clock - own clock by the exchanges of the last seconds.

    No message arrives before it is sent: each exchange says that

        far_sent - received <= theta <= far_received - sent,

    an interval as wide as its round trip. With time an interval gets wider by the drift of the clocks. What is left
    is the intersection of all of them: the fastest way there and the fastest way back decide, wherever they come
    from, and a slow exchange does no harm. The middle is the estimate (NTP's, where both come from one exchange), and
    half the width a bound of its error, whatever the delays were.

    Where intervals exclude each other, a clock has jumped (a computer that slept, a virtual machine that stood
    still), or by less than `SMALL` it was bent faster than `DRIFT`; then only the newest exchange counts.

    Args:
        drift: largest difference of the two clocks' speeds.
        kept: how many exchanges are looked at.

    Source: Marzullo and Owicki, Maintaining the time in a distributed system, 1983; RFC 5905.
    """

    def __init__(self, drift: float = DRIFT, kept: int = KEPT) -> None:
        self._drift, self._exchanges = drift, deque[Exchange](maxlen=kept)
        self.estimate: Offset | None = None

    @property
    def count(self) -> int:
        """Exchanges that are looked at."""
        return len(self._exchanges)

    def add(self, exchange: Exchange) -> Offset:
        """Take an exchange; return what is known by now.

        Raises:
            WireError: it came before its question.
            ClockJumpError: it contradicts the others by more than `SMALL`.
        """
        low, high = self._bounds(exchange.received)
        wider = self._drift * (exchange.received - exchange.sent)
        own_low = exchange.far_sent - exchange.received - wider
        own_high = exchange.far_received - exchange.sent + wider
        if own_low > own_high:
            raise WireError("an answer to a question for the time took less than no time")
        gap = max(low - own_high, own_low - high)
        if gap > 0:
            self._exchanges.clear()
            low, high = own_low, own_high
            if gap > SMALL:
                self._exchanges.append(exchange)
                raise ClockJumpError(
                    f"the clocks of the two machines are {gap / 1e6:.1f} ms further apart than a moment ago; one of "
                    "them has jumped (a computer that slept, or a virtual machine that stood still)"
                )
        self._exchanges.append(exchange)
        low, high = max(low, own_low), min(high, own_high)
        self.estimate = Offset(round((low + high) / 2), math.ceil((high - low) / 2), exchange.round_trip)
        return self.estimate

    def _bounds(self, now: int) -> tuple[float, float]:
        """What the exchanges so far leave possible now."""
        low, high = -float("inf"), float("inf")
        for one in self._exchanges:
            wider = self._drift * (now - one.sent)
            low = max(low, one.far_sent - one.received - wider)
            high = min(high, one.far_received - one.sent + wider)
        return low, high


class SteadyCorrection:
    """Follows the estimates with a clock that never stands still and never jumps, once it is set.

    Args:
        cell: where all who use it read the correction, as its first entry [ns].
    """

    STEEPEST = 5e-4  # s per s
    SHARE = 0.1  # of the distance, at most, that is made up at each estimate

    def __init__(self, cell) -> None:
        self._cell, self._at = cell, 0

    @property
    def value(self) -> int:
        """The correction [ns]."""
        return int(self._cell[0])

    def set(self, estimate: Offset, now: int) -> None:
        """Jump to an estimate; between episodes, when nothing runs by it."""
        self._cell[0], self._at = estimate.value, now

    def follow(self, estimate: Offset, now: int) -> None:
        """Come nearer to an estimate, at an instant of the own clock [ns]."""
        most = self.STEEPEST * (now - self._at)
        step = self.SHARE * (estimate.value - self.value)
        self._cell[0] = self.value + round(max(-most, min(most, step)))
        self._at = now
