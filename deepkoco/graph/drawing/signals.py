"""What the nodes of an episode sent, over time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.graph.drawing.style import PALETTE, DrawingError, Picture, figure_style
from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.model.graph import Graph

MOST_ENTRIES = 8
"""Numbers of an output that are drawn; what sends more, such as a camera, is left out."""
MOST_POINTS = 1500
"""Points of a line that are drawn; a longer one is thinned."""


class Signal(NamedTuple):
    """What one node sent.

    Attributes:
        node: its name.
        t: when it sent each output [s], (K,).
        values: (K, entries).
    """

    node: str
    t: np.ndarray
    values: np.ndarray


def signals_of(graph: Graph, episode: Episode) -> list[Signal]:
    """Outputs of all nodes that send few numbers, in the order in which they run."""
    found = []
    for position in graph.order:
        name = graph.nodes[position].name
        output = episode.outputs.get(name)
        if output is None or not len(output) or output.dtype.kind not in "biuf":
            continue
        values = np.asarray(output, dtype=np.float64).reshape(len(output), -1)
        if 0 < values.shape[1] <= MOST_ENTRIES:
            found.append(Signal(name, episode.t_end[name][: len(values)], values))
    return found


def draw_signals(
    graph: Graph, episode: Episode, start: float | None = None, stop: float | None = None
) -> Picture:
    """Draw the outputs of every node that sends few numbers, a panel a node; each value holds until the next.

    Args:
        graph: what ran.
        episode: its outputs.
        start, stop: part that is shown [s]; None: all of it.

    Returns:
        The figure, and a table with columns node, entry, t_s, value.

    Raises:
        DrawingError: no node sent such outputs in that part.
    """
    low, high = -np.inf if start is None else start, np.inf if stop is None else stop
    shown = []
    for signal in signals_of(graph, episode):
        kept = (signal.t >= low) & (signal.t <= high)
        if kept.any():
            shown.append(Signal(signal.node, signal.t[kept], signal.values[kept]))
    if not shown:
        raise DrawingError(f"no node sent up to {MOST_ENTRIES} numbers a step, so there is no signal to show")
    tables = []
    with figure_style():
        figure = Figure(figsize=(9.0, 0.6 + 1.5 * len(shown)))
        panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
        for axes, signal in zip(panels, shown, strict=True):
            stride = -(-len(signal.t) // MOST_POINTS)
            for entry, values in enumerate(signal.values.T):
                colour = PALETTE[entry % len(PALETTE)]
                axes.plot(
                    signal.t[::stride], values[::stride], color=colour, drawstyle="steps-post", lw=1.2,
                    label=f"entry {entry}",
                )  # fmt: skip
                tables.append(
                    pd.DataFrame({"node": signal.node, "entry": entry, "t_s": signal.t, "value": values})
                )
            axes.set_title(signal.node, loc="left", fontsize=10)
            if signal.values.shape[1] > 1:
                axes.legend(loc="upper right", ncols=signal.values.shape[1], fontsize=8)
        panels[-1].set_xlabel("time [s]")
    return Picture("signals", figure, pd.concat(tables, ignore_index=True))
