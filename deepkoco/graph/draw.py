"""Pictures of a graph and of who ran when and used whose message."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch

from deepkoco.graph.computation_graph import ComputationGraph
from deepkoco.graph.graph import Graph


def draw_timeline(
    axes: Axes, timing: ComputationGraph, start: float = 0.0, stop: float | None = None, row: int = 0
) -> None:
    """Draw the steps of one schedule as bars, one line a node, and an arrow to each step from the newest
    message that it used.

    Args:
        axes: where to draw.
        timing: the computation graph, drawn or replayed.
        start, stop: part of the episode that is shown [s]; None: to its end.
        row: schedule.
    """
    names, scale = timing.layout.names, timing.resolution
    if stop is None:
        stop = float(timing.steps_of(timing.layout.supervisor, row)[0][-1] / scale)
    heights = {n: len(names) - 1 - n for n in range(len(names))}
    shortest = (stop - start) / 200  # a step that takes no time is drawn as a mark
    for n in range(len(names)):
        begin, end = (t / scale for t in timing.steps_of(n, row))
        shown = (begin <= stop) & (end >= start)
        bars = list(zip(begin[shown], np.maximum(end - begin, shortest)[shown], strict=True))
        axes.broken_barh(bars, (heights[n] - 0.2, 0.4), color=f"C{n}")
    for edge in range(len(timing.layout.connections)):
        sender, receiver = int(timing.layout.sender[edge]), int(timing.layout.receiver[edge])
        sent, _ = (t / scale for t in timing.messages_of(edge, row))
        used = timing.steps_of(receiver, row)[0] / scale
        for now, newest in zip(used, timing.windows_of(edge, row).max(axis=1), strict=True):
            if newest >= 0 and start <= sent[newest] and now <= stop:
                ends = (sent[newest], heights[sender]), (now, heights[receiver])
                axes.annotate(
                    "", ends[1], ends[0], arrowprops={"arrowstyle": "->", "color": f"C{sender}", "alpha": 0.6}
                )
    axes.set_yticks(list(heights.values()), [names[n] for n in heights])
    axes.set_xlim(start, stop)
    axes.set_xlabel("time [s]")


def draw_graph(axes: Axes, graph: Graph) -> None:
    """Draw the nodes with their rates in a row and the connections with their expected delays.

    Skipped connections are dashed and pass below.
    """
    place = {graph.nodes[n].name: (float(i), 0.0) for i, n in enumerate(graph.order)}
    for connection in graph.connections:
        (x0, _), (x1, _) = place[connection.sender], place[connection.receiver]
        bend = 0.35 if connection.skip else (0.0 if abs(x1 - x0) == 1 else -0.35)
        if connection.sender == connection.receiver:
            continue
        axes.add_patch(
            FancyArrowPatch(
                (x0, 0),
                (x1, 0),
                connectionstyle=f"arc3,rad={bend if x1 > x0 else -bend}",
                arrowstyle="-|>",
                mutation_scale=14,
                shrinkA=28,
                shrinkB=28,
                linestyle="--" if connection.skip else "-",
                color="0.3",
            )
        )
        if connection.law.mean > 0:
            height = -bend * abs(x1 - x0) / 2
            text = f"{1000 * connection.law.mean:.3g} ms"
            axes.text((x0 + x1) / 2, height + 0.05, text, ha="center", va="bottom", fontsize=8)
    for name, (x, y) in place.items():
        label = f"{name}\n{float(graph.node(name).rate):g} Hz"
        axes.text(
            x, y, label, ha="center", va="center", bbox={"boxstyle": "round", "fc": "white", "ec": "C0"}
        )
    axes.set_xlim(-0.6, len(place) - 0.4)
    axes.set_ylim(-1.2, 1.2)
    axes.set_axis_off()
