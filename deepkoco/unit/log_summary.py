"""What a log holds, channel by channel: rate, gaps, jitter, range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepkoco.graph.recording import Recording, Series

GAP = 1.5  # a gap is a step of more than this many median steps


@dataclass(frozen=True)
class ChannelSummary:
    """One channel of a log.

    Attributes:
        name: Name of the channel.
        kind: ``"command"`` or ``"measurement"``.
        unit: Unit of its values.
        samples: Number of samples.
        start: First time stamp [s].
        stop: Last time stamp [s].
        rate_hz: Samples per median step; None for a single sample.
        jitter_s: Standard deviation of the steps that are no gaps [s].
        gaps: Steps of more than 1.5 median steps.
        longest_gap_s: Longest step [s].
        low: Smallest value.
        high: Largest value.
        sd: Standard deviation of the values.
    """

    name: str
    kind: str
    unit: str
    samples: int
    start: float
    stop: float
    rate_hz: float | None
    jitter_s: float | None
    gaps: int
    longest_gap_s: float | None
    low: float
    high: float
    sd: float


def summarise(recording: Recording) -> list[ChannelSummary]:
    """Summarise every channel of a log, in the log's order."""
    return [_summarise(name, series) for name, series in recording.channels.items()]


def _summarise(name: str, series: Series) -> ChannelSummary:
    step = np.diff(series.t)
    rate = jitter = longest = None
    gaps = 0
    if len(step):
        median = float(np.median(step))
        is_gap = step > GAP * median
        rate, longest, gaps = 1.0 / median, float(step.max()), int(is_gap.sum())
        jitter = float(step[~is_gap].std())
    return ChannelSummary(
        name=name,
        kind=series.kind,
        unit=series.unit,
        samples=len(series),
        start=float(series.t[0]),
        stop=float(series.t[-1]),
        rate_hz=rate,
        jitter_s=jitter,
        gaps=gaps,
        longest_gap_s=longest,
        low=float(series.value.min()),
        high=float(series.value.max()),
        sd=float(series.value.std()),
    )
