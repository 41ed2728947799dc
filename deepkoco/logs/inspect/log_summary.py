"""Summarise each channel of a log: rate, gaps, jitter, range."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepkoco.logs.recording import Recording, Series

if TYPE_CHECKING:
    from rich.table import Table

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
        rate_hz: 1 / median step; None for a single sample.
        jitter_s: Standard deviation of the steps without gaps [s].
        gaps: Number of steps of more than 1.5 median steps.
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


def summary_table(path: Path, recording: Recording) -> Table:
    """Format the summary of a log as a table for the terminal."""
    from rich.table import Table
    from rich.text import Text

    summaries = summarise(recording)
    seconds = max(s.stop for s in summaries) - min(s.start for s in summaries)
    result = Table(
        title=Text(f"{path} · {recording.system or 'unknown system'} · {seconds:.2f} s"),
        title_justify="left",
        box=None,
        padding=(0, 1, 0, 0),
    )
    for heading in ("channel", "kind"):
        result.add_column(heading, no_wrap=True)
    for heading in ("samples", "rate\nHz", "jitter\nms", "gaps", "longest\nms", "range"):
        result.add_column(heading, justify="right", no_wrap=True)
    for s in summaries:
        result.add_row(
            Text(f"{s.name} [{s.unit}]"),
            s.kind,
            str(s.samples),
            _shown(s.rate_hz, ".1f"),
            _shown(s.jitter_s, ".2f", 1e3),
            str(s.gaps),
            _shown(s.longest_gap_s, ".1f", 1e3),
            f"{s.low:.3g} .. {s.high:.3g}",
        )
    return result


def _shown(value: float | None, form: str, factor: float = 1.0) -> str:
    return "-" if value is None else format(factor * value, form)
