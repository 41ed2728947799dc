"""Histograms of measured delays against the laws that the graph gives them."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deepkoco.graph.delay import Delay, DelayError
from deepkoco.graph.drawing.style import ALARM, INK, DrawingError, Picture, colours, figure_style
from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.tables import measured_delays
from deepkoco.graph.model.graph import Graph

_BINS = 31  # odd: a constant delay lies in the middle of a bin
_TAIL = 0.002  # share of the longest delays that is counted in the last bin only
_COLUMNS = 3
_FOR_EVER = 1e9  # s


def draw_delays(graph: Graph, episodes: Iterable[Episode]) -> Picture:
    """Draw a histogram of every delay that varies or that the graph has a law for, and the law beside it.

    The last bar also counts what lies beyond it. A first-in-first-out connection delays messages that would
    overtake others, so its measured delays may exceed the law.

    Args:
        graph: with its laws.
        episodes: that were measured.

    Returns:
        The figure, and a table with channel, low_s, high_s, measured and expected share of each bin.

    Raises:
        DrawingError: there is no delay to show.
    """
    measured = measured_delays(graph, episodes)
    laws = {node.name: node.delay for node in graph.nodes} | {c.key: c.law for c in graph.connections}
    kept = {
        key: values
        for key, values in measured.items()
        if len(values) and (not laws[key].constant or laws[key].mean > 0 or np.ptp(values) > 1e-9)
    }
    if not kept:
        raise DrawingError("no step or message took any time, so there is no delay to show")
    colour = colours(graph)
    colour |= {c.key: colour[c.sender] for c in graph.connections}
    rows = math.ceil(len(kept) / _COLUMNS)
    tables = []
    with figure_style():
        columns = min(_COLUMNS, len(kept))
        figure = Figure(figsize=(3.6 * columns, 2.3 * rows + 0.35))
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, (key, values) in zip(grid, kept.items(), strict=False):
            tables.append(_draw(axes, key, values, laws[key], colour[key]))
        for axes in grid[len(kept) :]:
            axes.set_axis_off()
        for axes in grid[max(len(kept) - columns, 0) : len(kept)]:
            axes.set_xlabel("delay [ms]")
        for axes in grid[::columns]:
            axes.set_ylabel("share [%]")
        handles, labels = grid[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return Picture("delays", figure, pd.concat(tables, ignore_index=True))


def _draw(axes: Axes, key: str, values: np.ndarray, law: Delay, colour: str) -> pd.DataFrame:
    arrived = values[np.isfinite(values)]
    edges = _edges(arrived, law)
    share = np.histogram(np.minimum(arrived, edges[-1]), edges)[0] / len(values)
    expected = np.diff(_distribution(law, np.append(edges[1:-1], _FOR_EVER)), prepend=0.0)
    axes.stairs(100 * share, 1000 * edges, fill=True, color=colour, alpha=0.45, label="measured")
    axes.stairs(100 * expected, 1000 * edges, color=INK, lw=1.2, label="law of the graph")
    lost = len(values) - len(arrived)
    words = f"{len(values)} measured, mean {1000 * arrived.mean():.3g} ms" if len(arrived) else "none arrived"
    axes.set_title(f"{key}\n{words}", fontsize=8.5)
    if lost:
        axes.text(0.98, 0.92, f"{lost} lost", color=ALARM, ha="right", transform=axes.transAxes, fontsize=8)
    bins = {"channel": key, "low_s": edges[:-1], "high_s": edges[1:]}
    return pd.DataFrame(bins | {"measured": share, "expected": expected})


def _edges(arrived: np.ndarray, law: Delay) -> np.ndarray:
    ends = np.quantile(arrived, [0.0, 1.0 - _TAIL]).tolist() if len(arrived) else [law.mean]
    try:
        reach = [float(law.marginal.quantile(np.array(level))) for level in (_TAIL, 1.0 - _TAIL)]
    except DelayError:
        reach = [law.mean, law.mean]
    ends += [value for value in reach if math.isfinite(value)]
    low, high = min(ends), max(ends)
    margin = 0.05 * (high - low) + 0.05 * high * (high - low < 1e-9) + 1e-6
    return np.linspace(max(low - margin, 0.0), high + margin, _BINS + 1)


def _distribution(law: Delay, delay: np.ndarray) -> np.ndarray:
    """Probability of at most `delay`; for a law that cannot say it, the share of 20,000 draws."""
    try:
        return np.asarray(law.marginal.cdf(delay), dtype=np.float64)
    except DelayError:
        pass
    try:
        draws = np.sort(law.sample(np.random.default_rng(0), (20_000,)))
    except DelayError:
        return np.full(delay.shape, np.nan)
    return np.searchsorted(draws, delay, side="right") / len(draws)
