"""The picture of a comparison: what each controller costs, and how far the trained one is from it."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from deepkoco.agent.references.comparison import Comparison, MeanCost
from deepkoco.output.colours import COLOURS
from deepkoco.output.picture import Picture
from deepkoco.pages.units import rounded


def comparison_table(comparison: Comparison) -> pd.DataFrame:
    """One row per controller, the trained one first.

    Args:
        comparison: What was measured.

    Returns:
        Columns name, start_states, mean, low, high: cost of an episode with its 95 % interval; difference,
        difference_low, difference_high: trained minus reference, paired; verdict.
    """
    rows = [(comparison.agent, comparison.own, None, "")]
    rows += [(r.name, r.cost, r.difference, r.verdict) for r in comparison.references]
    count = len(comparison.costs[comparison.agent])
    return pd.DataFrame(
        [
            {
                "name": name,
                "start_states": count,
                **vars(cost),
                **{
                    column: getattr(difference, part, np.nan)
                    for column, part in (
                        ("difference", "mean"),
                        ("difference_low", "low"),
                        ("difference_high", "high"),
                    )
                },
                "verdict": verdict,
            }
            for name, cost, difference, verdict in rows
        ]
    )


def draw_references(comparison: Comparison) -> Picture:
    """Costs on the left, paired differences on the right.

    Args:
        comparison: What was measured.

    Returns:
        The picture, with the table of `comparison_table`.
    """
    references = comparison.references
    names = [comparison.agent, *(reference.name for reference in references)]
    figure = Figure(figsize=(9.0, 1.6 + 0.5 * len(names)))
    left, right = figure.subplots(1, 2, sharey=True)
    colours = ["EDMDc" if name.startswith("EDMDc") else "muted" for name in names]
    colours[0] = "DeepKoCo"
    for place, (name, colour) in enumerate(zip(names, colours, strict=True)):
        cost = comparison.own if place == 0 else references[place - 1].cost
        single = np.asarray(comparison.costs[name])
        left.plot(single, np.full(single.shape, place), "|", color=COLOURS[colour], alpha=0.35)
        _interval(left, cost, place, COLOURS[colour], rounded(cost.mean))
        if place:
            difference = references[place - 1].difference
            _interval(right, difference, place, COLOURS[colour], references[place - 1].verdict)
    right.axvline(0.0, color=COLOURS["measured"], linewidth=1.0)
    left.set_yticks(range(len(names)), names)
    left.set(xlabel="cost of an episode", ylim=(len(names) - 0.4, -0.8))
    right.set(xlabel=f"cost of {comparison.agent} minus that of the other")
    for axes in (left, right):
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.grid(axis="y", visible=False)
        axes.margins(x=0.12)
    caption = (
        f"From the same {len(comparison.costs[comparison.agent])} start states: on the left what an episode costs "
        "(a stroke each, the mean and its 95 % interval), on the right the mean of the differences from start state "
        "to start state and its 95 % interval; left of the line the trained controller is better. "
        f"{comparison.line[:1].upper()}{comparison.line[1:]}."
    )
    return Picture(
        "references", "Is it better than doing nothing?", caption, figure, comparison_table(comparison)
    )


def _interval(axes, cost: MeanCost, place: int, colour: str, text: str) -> None:
    error = [[cost.mean - cost.low], [cost.high - cost.mean]]
    known = np.isfinite([cost.low, cost.high]).all()
    axes.errorbar(cost.mean, place, xerr=error if known else None, fmt="o", color=colour, capsize=4, zorder=3)
    axes.annotate(
        text, (cost.mean, place), xytext=(0, 8), textcoords="offset points", ha="center", fontsize=9
    )
