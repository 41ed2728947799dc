"""Delays given at a reset: by channel, for all schedules or for each of them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from torch import Tensor

from deepkoco.graph.delay import Delay, DelayError, Deterministic, RecordedDelays, make_delay

Delays = Mapping[str, Any]
_LISTS = ("samples", "weights")  # parameters that are arrays of one law


class TimingError(ValueError):
    """A timing cannot be drawn or replayed; the message says for which node or connection and why."""


class ChannelLaws(NamedTuple):
    """Where the delays of each channel come from.

    Attributes:
        same: laws for all schedules, of all channels that are not below.
        own: a law for each schedule.
        constants: a constant for each schedule, (R,) [s].
        traces: recordings that are played.
    """

    same: dict[str, Delay]
    own: dict[str, tuple[Delay, ...]]
    constants: dict[str, np.ndarray]
    traces: RecordedDelays | None

    @property
    def constant(self) -> bool:
        """Whether all schedules have the same delays."""
        varies = self.own or self.constants or self.traces
        return not varies and all(law.constant for law in self.same.values())

    def take(self, rows: np.ndarray) -> "ChannelLaws":
        """Keep the laws of some schedules."""
        own = {key: tuple(laws[r] for r in rows.tolist()) for key, laws in self.own.items()}
        return self._replace(own=own, constants={key: value[rows] for key, value in self.constants.items()})


def read_overrides(
    laws: dict[str, Delay], nodes: Sequence[str], overrides: Delays, rows: int, traces: RecordedDelays | None
) -> ChannelLaws:
    """Put the delays of a reset in the place of the graph's own.

    Args:
        laws: the graph's own, by channel.
        nodes: channels that are computations: they cannot get lost.
        overrides: as for `draw_timing`.
        rows: number of schedules.
        traces: recordings, whose channels come before everything else.

    Raises:
        TimingError: names the channel and what is wrong with its delay.
    """
    found = ChannelLaws(dict(laws), {}, {}, traces)
    for key in (*overrides, *(traces.channels if traces else ())):
        if key not in laws:
            raise TimingError(f'delay of "{key}": no such node or connection; known: {", ".join(laws)}')
    for key, override in overrides.items():
        try:
            _read(found, key, override, rows)
        except DelayError as error:
            raise TimingError(f'delay of "{key}": {error}') from error
    for key in traces.channels if traces else ():
        for place in (found.same, found.own, found.constants):
            place.pop(key, None)
    for key in nodes:
        lossy = key in found.same and found.same[key].loses
        lossy |= any(law.loses for law in found.own.get(key, ()))
        if lossy or (traces and key in traces.channels and traces.loses(key)):
            raise TimingError(f'delay of "{key}": a computation cannot get lost; only messages can')
    return found


def _read(found: ChannelLaws, key: str, override: Any, rows: int) -> None:
    if isinstance(override, Mapping):
        each = {
            name: np.asarray(value, dtype=np.float64)
            for name, value in override.items()
            if isinstance(value, (np.ndarray, Tensor)) and np.ndim(value) and name not in _LISTS
        }
        if each:
            for name, values in each.items():
                _check(values, rows, f"{name}: ")
            override = [
                dict(override) | {name: float(values[row]) for name, values in each.items()}
                for row in range(rows)
            ]
    if isinstance(override, (Delay, Mapping, int, float)):
        found.same[key] = make_delay(override)
        return
    if isinstance(override, Sequence) and any(isinstance(spec, (Delay, Mapping)) for spec in override):
        if len(override) != rows:
            raise DelayError(f"expected {rows} laws, one each, got {len(override)}")
        made = []
        for row, spec in enumerate(override):
            try:
                made.append(make_delay(spec))
            except DelayError as error:
                raise DelayError(f"schedule {row}: {error}") from error
        del found.same[key]
        found.own[key] = tuple(made)
        return
    try:
        values = np.asarray(override, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DelayError(f"expected {rows} finite numbers of seconds >= 0, one each") from error
    _check(values, rows, "")
    if (values < 0).any():
        raise DelayError(f"expected {rows} finite numbers of seconds >= 0, one each")
    if (values == values[0]).all():
        found.same[key] = Deterministic(float(values[0]))
    else:
        del found.same[key]
        found.constants[key] = values


def _check(values: np.ndarray, rows: int, name: str) -> None:
    if values.shape != (rows,) or not np.isfinite(values).all():
        raise DelayError(
            f"{name}expected {rows} finite numbers of seconds >= 0, one each, got shape {values.shape}"
        )
