"""The figure of a comparison: a row per task and distractors, a column per axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import EngFormatter, MaxNLocator

from deepkoco.output.whole_file import whole_file
from experiments.studies.learning.comparison.references import References
from experiments.studies.learning.comparison.runs import AXES, METHOD, PANEL, groups
from experiments.studies.learning.comparison.style import (
    REFERENCE_COLOUR,
    STYLE,
    method_rank,
    method_style,
    variant_line,
)

HEIGHT = 1.1  # of a panel, in costs of a random policy
CONDITIONS = {"none": "clean"}


def panel_title(task: str, observation: str, distractors: str) -> str:
    """Name of a panel, such as "pendulum, images, distractors copies"."""
    seen = "" if observation == "states" else f", {observation}"
    return f"{task}{seen}, {CONDITIONS.get(distractors, f'distractors {distractors}')}"


def method_label(agent: str, variant: str) -> str:
    """Name of a method in legends and tables."""
    return method_style(agent).label + (f" ({variant})" if variant else "")


def draw(
    curves: pd.DataFrame,
    references: Mapping[str, References | None],
    path: Path,
    chosen: Sequence[str] = ("episodes", "steps", "updates", "seconds"),
) -> None:
    """Draw interquartile means with their bands, the optimum and a random policy.

    Args:
        curves: As given by `curves.learning_curves`.
        references: By task; the tasks are drawn in this order.
        path: PNG to write, all or nothing.
        chosen: The axes, a column each.
    """
    panels = {tuple(names.values()): own for names, own in groups(curves, PANEL)}
    tasks = list(references)
    order = sorted(panels, key=lambda panel: (tasks.index(panel[0]), panel[2] != "none", panel))
    with plt.rc_context(fname=STYLE):
        size = (3.3 * len(chosen), 2.9 * len(panels))
        figure, axes = plt.subplots(len(panels), len(chosen), figsize=size, sharey="row", squeeze=False)
        for panel, row in zip(order, axes, strict=True):
            by_axis = {names["axis"]: own for names, own in groups(panels[panel], ["axis"])}
            for name, axis in zip(chosen, row, strict=True):
                if name in by_axis:
                    _draw_panel(axis, by_axis[name], references[panel[0]])
                axis.set_xlabel(AXES[name])
            row[0].set(title=panel_title(*panel), ylabel="noise-free cost of an episode")
            row[-1].legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        with whole_file(path) as partial:
            figure.savefig(partial, dpi=150)
            plt.close(figure)


def _draw_panel(axis: Axes, curves: pd.DataFrame, reference: References | None) -> None:
    methods = {(names["agent"], names["variant"]): own for names, own in groups(curves, METHOD)}
    for agent, variant in sorted(methods, key=lambda method: (method_rank(method[0]), method[1])):
        own = methods[agent, variant]
        variants = [other for name, other in methods if name == agent]
        seeds, unfinished = own["seeds"].iloc[0], own["unfinished"].iloc[0]
        marked = f", {unfinished} unfinished" if unfinished else ""
        colour = method_style(agent).colour
        axis.plot(
            own["x"],
            own["iqm"],
            color=colour,
            linestyle=variant_line(variant, variants),
            marker="o" if len(own) == 1 else None,
            label=f"{method_label(agent, variant)} (n = {seeds}{marked})",
        )
        axis.fill_between(own["x"], own["low"], own["high"], color=colour, alpha=0.2, linewidth=0)
    axis.set_xlim(left=0)
    axis.xaxis.set_major_locator(MaxNLocator(4))
    axis.xaxis.set_major_formatter(EngFormatter(sep=""))
    axis.set_ylim(bottom=0)
    if reference is not None:
        lines = {"random policy": (reference.random, ":"), "optimum": (reference.optimum, "--")}
        for label, (cost, line) in lines.items():
            axis.axhline(cost, color=REFERENCE_COLOUR, linestyle=line, linewidth=1, label=label)
        axis.set_ylim(0, max(HEIGHT * reference.random, float(curves["iqm"].to_numpy().max())))
