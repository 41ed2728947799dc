"""Pictures of computation graphs and of the supergraph that runs them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from deepkoco.graph.drawing.style import INK, PALETTE, QUIET, DrawingError, Picture, figure_style
from deepkoco.graph.supergraph import MergedSlots
from deepkoco.graph.timing.computation_graph import ComputationGraph

_SHOWN = 4  # supervisor steps that are shown unless asked otherwise


def draw_computation_graph(timing: ComputationGraph, row: int = 0, steps: int = _SHOWN) -> Picture:
    """Draw the steps of a schedule as vertices over time, with edges from each message to every step that saw it.

    Lines within a lane are the state that a node hands to its next step. Vertices that run before the same
    step of the supervisor (one partition) stand on one band.

    Args:
        timing: drawn or replayed.
        row: schedule.
        steps: supervisor steps that are shown.

    Returns:
        The figure, and a table with a row for each vertex and edge.
    """
    names, supervisor = timing.layout.names, timing.layout.supervisor
    vertices = timing.vertices(row)
    place = np.searchsorted(timing.steps_of(supervisor, row)[0], vertices.t_start, side="left")
    acts = timing.steps_of(supervisor, row)[0] / timing.resolution
    steps = min(steps, len(acts) - 1)
    begin = np.array(vertices.t_start) / timing.resolution
    shown = begin <= acts[steps]
    lane = len(names) - 1 - np.array(vertices.node)
    edges = timing.edges(row)
    edges = edges[shown[edges].all(axis=1)]
    own = vertices.node[edges[:, 0]] == vertices.node[edges[:, 1]]
    points = np.stack([begin, lane], axis=1)
    with figure_style():
        figure = Figure(figsize=(10.0, 1.1 + 0.55 * len(names)))
        axes = figure.subplots()
        for k, (left, right) in enumerate(zip([0.0, *acts[:steps]], acts[: steps + 1], strict=True)):
            if k % 2 == 0:
                axes.axvspan(left, right, color="#000000", alpha=0.04, lw=0, zorder=0)
        colour = np.array([PALETTE[n % len(PALETTE)] for n in range(len(names))])
        axes.add_collection(
            LineCollection(list(points[edges[own]]), colors=QUIET, lw=0.8, ls=":", label="state", zorder=1)
        )
        used = edges[~own]
        axes.add_collection(
            LineCollection(
                list(points[used]),
                colors=colour[vertices.node[used[:, 0]]].tolist(),
                lw=1.0,
                alpha=0.7,
                label="message",
                zorder=2,
            )
        )
        axes.scatter(begin[shown], lane[shown], s=34, c=colour[vertices.node[shown]], zorder=3)
        if steps <= _SHOWN and len(names) <= 6:
            for i in np.flatnonzero(shown):
                number = str(vertices.seq[i])
                axes.annotate(
                    number, points[i], (0, 6), textcoords="offset points", fontsize=6.5, ha="center"
                )
        axes.set_yticks(range(len(names) - 1, -1, -1), list(names))
        axes.set_ylim(-0.6, len(names) - 0.4)
        axes.set_xlim(-0.01 * acts[steps], 1.01 * acts[steps])
        axes.set_xlabel("time [s]")
        axes.grid(False)
        handles = [
            Line2D([], [], lw=0, marker="o", color=INK, label="step"),
            Line2D([], [], color=INK, lw=1.0, label="message that a step saw"),
            Line2D([], [], color=QUIET, lw=0.8, ls=":", label="state"),
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=3, fontsize=8)
    told = {"node": [names[n] for n in vertices.node], "seq": vertices.seq, "t_start_s": begin}
    table = pd.DataFrame(told | {"partition": place}).loc[shown].assign(kind="step")
    ends = {"node": [names[n] for n in vertices.node[edges[:, 1]]], "seq": vertices.seq[edges[:, 1]]}
    ends |= {"from": [names[n] for n in vertices.node[edges[:, 0]]], "from_seq": vertices.seq[edges[:, 0]]}
    kinds = np.where(own, "state", "message")
    return Picture("computation_graph", figure, pd.concat([table, pd.DataFrame(ends | {"kind": kinds})]))


def slot_table(names: Sequence[str], merged: MergedSlots, supervisor: int) -> pd.DataFrame:
    """Tell how often each slot of a supergraph is used.

    A pass counts if anything can run in it: the pass that ends at supervisor step k is that of table[:, k].

    Returns:
        Columns slot, node, utilisation (share of passes of all schedules in which it runs a step). The supervisor's
        own step, which ends every pass, is the last row.
    """
    runs = (np.asarray(merged.table) >= 0).mean(axis=(0, 1))
    slots = [names[n] for n in merged.slots]
    return pd.DataFrame(
        {
            "slot": np.arange(len(slots) + 1),
            "node": [*slots, names[supervisor]],
            "utilisation": [*runs.tolist(), 1.0],
        }
    )


def draw_supergraph(names: Sequence[str], merged: MergedSlots, supervisor: int) -> Picture:
    """Draw the slots of a supergraph in the order in which they run, filled by how often they are used.

    Args:
        names: of the nodes.
        merged: slots, and which step each runs before which supervisor step.
        supervisor: its index.

    Returns:
        The figure, and a table with slot, node and utilisation.

    Raises:
        DrawingError: there is no pass.
    """
    if merged.table.size == 0 and merged.table.shape[1] == 0:
        raise DrawingError("the supergraph has no pass: its timing has no supervisor step")
    table = slot_table(names, merged, supervisor)
    lanes = {name: len(names) - 1 - n for n, name in enumerate(names)}
    colour = {name: PALETTE[n % len(PALETTE)] for n, name in enumerate(names)}
    use = table["utilisation"].to_numpy()
    with figure_style():
        figure = Figure(figsize=(min(3.2 + 0.24 * len(table), 24.0), 2.3 + 0.33 * len(names)))
        above, axes = figure.subplots(2, 1, sharex=True, height_ratios=[1.0, 0.3 * len(names) + 0.3])
        above.bar(table["slot"], 100 * use, width=0.8, color=[colour[n] for n in table["node"]])
        above.axhline(100 * use.mean(), color=INK, lw=1, ls="--")
        above.set_ylim(0, 105)
        above.set_ylabel("used [%]")
        above.set_title(f"{len(table)} slots, {100 * use.mean():.1f} % used on average (dashed)")
        frames = [
            Rectangle((s - 0.4, lanes[n] - 0.36), 0.8, 0.72) for s, n in zip(*_slots(table), strict=True)
        ]
        filled = [
            Rectangle((s - 0.4, lanes[n] - 0.36), 0.8, 0.72 * u)
            for s, n, u in zip(*_slots(table), use, strict=True)
        ]
        tints = [colour[n] for n in table["node"]]
        axes.add_collection(PatchCollection(frames, facecolor="white", edgecolor=tints, lw=0.9))
        axes.add_collection(PatchCollection(filled, facecolor=tints, edgecolor="none"))
        axes.plot(table["slot"], [lanes[n] for n in table["node"]], color=QUIET, lw=0.6, zorder=0)
        axes.set_yticks(list(lanes.values()), list(lanes))
        axes.set_ylim(-0.6, len(names) - 0.4)
        axes.set_xlim(-0.8, len(table) - 0.2)
        axes.set_xlabel("slot, in the order in which they run")
        axes.grid(axis="x", visible=False)
    return Picture("supergraph", figure, table)


def _slots(table: pd.DataFrame) -> tuple[list[int], list[str]]:
    return table["slot"].tolist(), table["node"].tolist()
