"""What an effect at a joint sees, and how it remembers."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from deepkoco.systems.parameter import Parameters


class JointState(NamedTuple):
    """What a load on one joint may depend on, all of one shape (...)."""

    angle: Tensor  # joint coordinate [rad or m]
    speed: Tensor  # per second
    effort: Tensor  # of the command that drives this joint, in its unit; 0 where none does
    time: Tensor | None  # log time [s]; None where the caller keeps none
    smoothing: Tensor | float  # speed over which the sign of dry friction changes, per second


class JointLanes:
    """A joint's state in some lanes (the last axis), each part cut only if an effect asks for it."""

    __slots__ = ("_start", "_state", "_stop")

    def __init__(self, state: JointState, lanes: slice) -> None:
        self._state, self._start, self._stop = state, lanes.start, lanes.stop

    @property
    def angle(self) -> Tensor:
        """As :class:`JointState`'s."""
        return self._cut(self._state.angle)

    @property
    def speed(self) -> Tensor:
        """As :class:`JointState`'s."""
        return self._cut(self._state.speed)

    @property
    def effort(self) -> Tensor:
        """As :class:`JointState`'s."""
        return self._cut(self._state.effort)

    @property
    def time(self) -> Tensor | None:
        """As :class:`JointState`'s."""
        return None if self._state.time is None else self._cut(self._state.time)

    @property
    def smoothing(self) -> Tensor | float:
        """As :class:`JointState`'s."""
        smoothing = self._state.smoothing
        return self._cut(smoothing) if isinstance(smoothing, Tensor) else smoothing

    def _cut(self, value: Tensor) -> Tensor:
        return in_lanes(value, self._start, self._stop)


def in_lanes(value: Tensor, start: int, stop: int) -> Tensor:
    """The lanes from ``start`` to before ``stop`` of what has one value per lane, and anything else as it is."""
    if value.ndim == 0 or value.shape[-1] == 1:
        return value
    return value.narrow(-1, start, stop - start)


class Memory(NamedTuple):
    """How the value that an effect remembers begins, and how it changes while the joint moves.

    Attributes:
        start: (joint, load that would hold it at rest, p) -> value at the start of a window.
        advance: (value, way, joint, p) -> value after the joint has moved this way in one direction.
    """

    start: Callable[[JointState, Tensor, Parameters], Tensor]
    advance: Callable[[Tensor, Tensor, JointState, Parameters], Tensor]
