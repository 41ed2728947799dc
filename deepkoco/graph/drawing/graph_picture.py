"""The picture of a graph: who sends to whom, how often, how late."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path as Curve
from matplotlib.textpath import TextPath

from deepkoco.graph.drawing.layers import Box, Placement, Size, place
from deepkoco.graph.drawing.style import INK, QUIET, Picture, colours, figure_style
from deepkoco.graph.drawing.words import connection_words, loop_words, node_words
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph

_NAME, _SMALL = 10.0, 7.5  # font sizes [pt]
_LINE = 1.35  # height of a line in font sizes
_MARGIN = 0.25  # around the picture [in]


def draw_graph(graph: Graph) -> Picture:
    """Draw nodes in layers by the flow of data, with rates and delays.

    Returns:
        The figure, sized to its content, and a table with a row per node and connection.
    """
    with figure_style():
        lines = {node.name: node_words(node) + loop_words(graph, node) for node in graph.nodes}
        sizes = {
            name: Size(
                max(_width(name, _NAME, True), *(_width(t, _SMALL) for t in below)) + 0.30,
                (_NAME + len(below) * _SMALL) * _LINE / 72 + 0.20,
            )
            for name, below in lines.items()
        }
        labels = {c.key: connection_words(c) for c in graph.connections}
        label_sizes = {
            key: Size(max(_width(t, _SMALL) for t in text) + 0.10, len(text) * _SMALL * _LINE / 72 + 0.06)
            for key, text in labels.items()
            if text
        }
        placed = place(graph, sizes, label_sizes)
        width, height = placed.width + 2 * _MARGIN, placed.height + 2 * _MARGIN
        below = 0.25  # for the legend
        width = max(width, 7.0)
        figure = Figure(figsize=(width, height + below))
        figure.set_layout_engine("none")
        axes = figure.add_axes((0, 0, 1, 1))
        left = (width - placed.width) / 2
        axes.set_xlim(-left, width - left)
        axes.set_ylim(-_MARGIN - below, placed.height + _MARGIN)
        axes.set_axis_off()
        colour = colours(graph)
        for connection in graph.connections:
            _draw_connection(axes, connection, placed, labels[connection.key], colour[connection.sender])
        for node in graph.nodes:
            supervises = node.name == graph.supervisor
            _draw_box(
                axes, placed.boxes[node.name], node.name, lines[node.name], colour[node.name], supervises
            )
        _legend(axes)
    return Picture("graph", figure, _table(graph))


def _draw_box(axes: Axes, box: Box, name: str, below: list[str], colour: str, supervises: bool) -> None:
    corner = box.x - box.width / 2, box.y - box.height / 2
    patch = FancyBboxPatch(
        corner,
        box.width,
        box.height,
        boxstyle="round,pad=0,rounding_size=0.08",
        facecolor="#f4f4f2" if supervises else "white",
        edgecolor=colour,
        linewidth=2.6 if supervises else 1.6,
        label=name,
        zorder=3,
    )
    axes.add_patch(patch)
    top = box.y + (_NAME + len(below) * _SMALL) * _LINE / 144
    axes.text(box.x, top, name, ha="center", va="top", fontsize=_NAME, fontweight="bold", color=INK, zorder=4)
    for i, line in enumerate(below):
        y = top - (_NAME + i * _SMALL) * _LINE / 72
        axes.text(box.x, y, line, ha="center", va="top", fontsize=_SMALL, color=INK, zorder=4)


def _draw_connection(
    axes: Axes, connection: Connection, placed: Placement, text: list[str], colour: str
) -> None:
    options = {
        "linestyle": (0, (4, 2.5)) if connection.skip else "-",
        "linewidth": 2.4 if connection.blocking else 1.2,
        "color": colour,
        "label": connection.key,
    }
    if connection.sender == connection.receiver:
        box = placed.boxes[connection.sender]
        corner = box.x + box.width / 2 - 0.16, box.y + box.height / 2 + 0.03
        axes.add_patch(Circle(corner, 0.08, fill=False, zorder=1, **options))
        return
    curve = _smooth(placed.routes[connection.key])
    axes.add_patch(
        FancyArrowPatch(
            path=curve,
            arrowstyle="-|>",
            mutation_scale=11,
            shrinkA=0,
            shrinkB=0,
            zorder=2,
            joinstyle="miter",
            capstyle="butt",
            **options,
        )
    )
    if connection.key in placed.labels:
        label = placed.labels[connection.key]
        axes.text(
            label.x, label.y, "\n".join(text), ha="center", va="center", fontsize=_SMALL, color=INK, zorder=3,
            linespacing=1.15, bbox={"boxstyle": "square,pad=0.12", "fc": "white", "ec": "none"},
        )  # fmt: skip


def _smooth(points: np.ndarray) -> Curve:
    """Curve through points that leaves and reaches each of them horizontally."""
    vertices, codes = [points[0]], [int(Curve.MOVETO)]
    for start, end in itertools.pairwise(points):
        if np.allclose(start, end):
            continue
        middle = (start[0] + end[0]) / 2
        vertices += [(middle, start[1]), (middle, end[1]), end]
        codes += [int(Curve.CURVE4)] * 3
    return Curve(np.array(vertices), codes)


def _legend(axes: Axes) -> None:
    handles = [
        Line2D([], [], color=QUIET, lw=1.2, label="takes what is there"),
        Line2D([], [], color=QUIET, lw=2.4, label="waits (blocking)"),
        Line2D([], [], color=QUIET, lw=1.2, ls=(0, (4, 2.5)), label="for the next step (skip)"),
        Line2D([], [], lw=0, label="delays: mean (5–95 %)"),
    ]
    axes.legend(
        handles=handles, loc="lower center", ncols=4, fontsize=_SMALL, handlelength=2.0, columnspacing=1.2
    )


def _width(text: str, size: float, bold: bool = False) -> float:
    path = TextPath((0, 0), text, size=size, prop={"weight": "bold"} if bold else None)  # pyright: ignore[reportArgumentType]
    return float(path.get_extents().width) / 72


def _table(graph: Graph) -> pd.DataFrame:
    rows = []
    for n, node in enumerate(graph.nodes):
        row = {"kind": "node", "name": node.name, "rate_hz": float(node.rate), "scheduling": node.scheduling}
        rows.append(row | {"phase_s": float(graph.phases[n]), "delay_mean_s": node.delay.mean})
    for c in graph.connections:
        row = {"kind": "connection", "name": c.key, "delay_mean_s": c.law.mean, "window": c.window}
        rows.append(row | {"skip": c.skip, "blocking": c.blocking, "jitter": c.jitter})
    return pd.DataFrame(rows)
