"""The timeline of an episode: who ran when, and which message was used where."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from deepkoco.graph.drawing.style import ALARM, INK, QUIET, DrawingError, Picture, colours, figure_style
from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.tables import messages_table, steps_table
from deepkoco.graph.model.graph import Graph

_HALF = 0.15  # half the height of a bar, in lanes
_NEAR, _FAR = 0.20, 0.42  # where the queues of the inputs lie beside a bar, in lanes
_SHOWN = 8  # supervisor steps that are shown unless asked otherwise


def draw_timeline(
    graph: Graph, episode: Episode, start: float | None = None, stop: float | None = None
) -> Picture:
    """Draw the steps as bars, one lane a node, and every message from its sending to its first use.

    A message leaves its sender's bar, slopes to the lane of the receiver, where it arrives, and lies
    there in a queue (a level line) until the step that sees it first (a dot). One that never arrives
    ends in a cross, one that no step sees has no dot. Steps longer than a period are outlined in red, gaps
    in which a node missed a tick are shaded.

    Args:
        graph: what ran.
        episode: its times and windows.
        start, stop: part that is shown [s]; None: the first supervisor steps.

    Returns:
        The figure, and a table with a row for each step and message in that part.

    Raises:
        DrawingError: nothing ran in that part.
    """
    start, stop = _limits(graph, episode, start, stop)
    steps, messages = steps_table(graph, episode), messages_table(graph, episode)
    steps = steps[(steps.t_start_s <= stop) & (steps.t_end_s >= start)]
    last = messages[["t_received_s", "t_used_s"]].max(axis=1).fillna(messages.t_sent_s)
    messages = messages[(messages.t_sent_s <= stop) & (last >= start)]
    if steps.empty:
        raise DrawingError(f"nothing ran between {start:g} s and {stop:g} s")
    lanes = {graph.nodes[n].name: len(graph.nodes) - 1 - i for i, n in enumerate(graph.order)}
    colour = colours(graph)
    with figure_style():
        figure = Figure(figsize=(10.5, 0.95 + 0.85 * len(lanes)))
        axes = figure.subplots()
        for t in steps.t_start_s[steps.node == graph.supervisor]:
            axes.axvline(t, color=QUIET, lw=0.8, ls=(0, (1, 2)), zorder=0)
        for node in graph.nodes:
            mine = steps.loc[steps["node"] == node.name]
            _draw_steps(axes, mine, lanes[node.name], colour[node.name], (stop - start) / 400)
        for connection in graph.connections:
            mine = messages.loc[messages["connection"] == connection.key]
            place = _queue_height(graph, lanes, connection.key)
            _draw_messages(axes, mine, lanes, connection.sender, connection.receiver, place, colour)
        axes.set_yticks(list(lanes.values()), list(lanes))
        axes.set_ylim(-0.6, len(lanes) - 0.4)
        axes.set_xlim(start, stop)
        axes.set_xlabel("time [s]")
        axes.grid(False)
        _legend(figure)
    table = pd.concat([steps, messages], keys=["step", "message"], names=["kind"])
    return Picture("timeline", figure, table.reset_index("kind"))


def _limits(graph: Graph, episode: Episode, start: float | None, stop: float | None) -> tuple[float, float]:
    ends = [float(t.max()) for t in episode.t_end.values() if len(t)]
    if not ends:
        raise DrawingError("the episode has no steps")
    acts = episode.t_start[graph.supervisor]
    start = 0.0 if start is None else start
    if stop is None:
        later = acts[acts > start]
        stop = float(later[min(_SHOWN, len(later)) - 1]) if len(later) else max(ends)
    if not stop > start:
        raise DrawingError(f"stop {stop:g} s is not after start {start:g} s")
    return start, stop + 0.01 * (stop - start)


def _queue_height(graph: Graph, lanes: dict[str, int], key: str) -> float:
    """Height at which the messages of a connection lie in the lane of the receiver, on the sender's side."""
    connection = next(c for c in graph.connections if c.key == key)
    lane = lanes[connection.receiver]
    above = lanes[connection.sender] >= lane
    beside = [c.key for c in graph.inputs_of(connection.receiver) if (lanes[c.sender] >= lane) == above]
    share = (beside.index(key) + 0.5) / len(beside)
    offset = _NEAR + (_FAR - _NEAR) * share
    return lane + (offset if above else -offset)


def _draw_steps(axes: Axes, steps: pd.DataFrame, lane: float, colour: str, shortest: float) -> None:
    for begin, late in _rows(steps.loc[steps["late_s"] > 0], "t_start_s", "late_s"):
        axes.broken_barh([(begin - late, late)], (lane - _HALF, 2 * _HALF), color=ALARM, alpha=0.13, lw=0)
    # A step that takes no time is drawn as a mark.
    bars = list(zip(steps.t_start_s, np.maximum(steps.t_end_s - steps.t_start_s, shortest), strict=True))
    edges = np.where(steps.overrun, ALARM, colour)
    axes.broken_barh(
        bars, (lane - _HALF, 2 * _HALF), facecolor=colour, edgecolor=edges, linewidth=1.2, zorder=3
    )


def _draw_messages(
    axes: Axes,
    messages: pd.DataFrame,
    lanes: dict[str, int],
    sender: str,
    receiver: str,
    queue: float,
    colour: dict[str, str],
) -> None:
    side = 1 if queue > lanes[receiver] else -1
    leaves = lanes[sender] - side * _HALF
    lands = lanes[receiver] + side * _HALF
    came, seen = messages["t_received_s"].notna(), messages["t_used_s"].notna()
    arrived, used, lost = messages.loc[came], messages.loc[came & seen], messages.loc[~came]
    # What nobody used, and what crosses other lanes, stays in the background.
    strength = 0.8 if abs(lanes[sender] - lanes[receiver]) <= 1 else 0.4
    # Matplotlib takes no empty list of strengths.
    strengths = np.where(seen[came], strength, 0.3 * strength) if came.to_numpy().any() else None
    flights = [
        [(sent, leaves), (received, queue)] for sent, received in _rows(arrived, "t_sent_s", "t_received_s")
    ]
    waits = [
        [(received, queue), (at, queue), (at, lands)]
        for received, at in _rows(used, "t_received_s", "t_used_s")
    ]
    key = f"{sender}->{receiver}"
    axes.add_collection(
        LineCollection(
            flights, colors=colour[sender], lw=0.9, alpha=strengths, label=f"flights {key}", zorder=2
        ),
        autolim=False,
    )
    axes.add_collection(
        LineCollection(waits, colors=colour[sender], lw=0.9, alpha=0.55, label=f"waits {key}", zorder=2),
        autolim=False,
    )
    axes.plot(used["t_used_s"], [lands] * len(used), "o", ms=3.2, color=colour[sender], zorder=4)
    axes.plot(lost["t_sent_s"], [leaves] * len(lost), "x", ms=6, mew=1.6, color=ALARM, zorder=4)


def _rows(frame: pd.DataFrame, *columns: str) -> Iterator[tuple[float, ...]]:
    return zip(*(frame[column].tolist() for column in columns), strict=True)


def _legend(figure: Figure) -> None:
    handles = [
        Patch(color=QUIET, label="step"),
        Patch(facecolor=QUIET, edgecolor=ALARM, lw=1.4, label="longer than a period"),
        Patch(color=ALARM, alpha=0.13, label="late"),
        Line2D([], [], color=INK, lw=0.9, label="message on its way, then waiting"),
        Line2D([], [], color=INK, lw=0, marker="o", ms=3.5, label="first used"),
        Line2D([], [], color=ALARM, lw=0, marker="x", mew=1.6, label="lost"),
        Line2D([], [], color=QUIET, lw=0.8, ls=(0, (1, 2)), label="supervisor acts"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=7, fontsize=8, handlelength=1.6)
