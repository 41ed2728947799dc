"""Figures of the study: power curves and confusion matrices."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from deepkoco.output.whole_file import whole_file
from experiments.hidden.power import HITS, NOTHING, UNKNOWN

STYLE = str(files("deepkoco.output").joinpath("figures.mplstyle"))
Line = dict[str, Any]


def draw_power(lines: Sequence[Line], path: Path) -> None:
    """Shares against strength, one panel per study, Wilson's 95 % intervals.

    Args:
        lines: As given by :func:`experiments.hidden.power.power`.
        path: PNG to write, all or nothing.
    """
    studies = sorted({(line["system"], line["condition"]) for line in lines})
    columns = min(max(len(studies), 1), 3)
    rows = max(-(-len(studies) // columns), 1)
    with plt.rc_context(fname=STYLE):
        figure, axes = plt.subplots(
            rows, columns, figsize=(4.2 * columns, 3.2 * rows), squeeze=False, sharex=True, sharey=True
        )
        for axis, study in zip(axes.ravel(), studies, strict=False):
            for k, measure in enumerate(HITS):
                own = [x for x in lines if (x["system"], x["condition"]) == study and x["measure"] == measure]
                shares = np.array([x["share"] for x in own])
                # Wilson's interval need not be symmetric; rounding may put an end past the share.
                error = np.clip(
                    [shares - [x["low"] for x in own], [x["high"] for x in own] - shares], 0.0, None
                )
                at = np.array([x["ES"] for x in own]) * 1.03 ** (k - 1)
                axis.errorbar(at, shares, error, marker="o", markersize=3.5, capsize=2, label=measure)
            count = sum(x["of"] for x in lines if (x["system"], x["condition"]) == study) // len(HITS)
            axis.set(xscale="log", ylim=(-0.03, 1.03), title=f"{study[0]}, {study[1]} ({count} cases)")
        for axis in axes.ravel()[len(studies) :]:
            axis.set_axis_off()
        for axis in axes[-1]:
            axis.set_xlabel("strength ES [noise standard deviations]")
        for axis in axes[:, 0]:
            axis.set_ylabel("share of single causes")
        axes[0, 0].legend(fontsize=7, loc="lower right")
        _write(figure, path)


def draw_confusion(lines: Sequence[Line], path: Path, title: str) -> None:
    """What was named first (columns) for what was hidden (rows), in cases.

    Args:
        lines: As given by :func:`experiments.hidden.power.confusion`, of one study.
        path: PNG to write, all or nothing.
        title: Written above.
    """
    hidden = sorted({x["hidden"] for x in lines}, key=lambda name: (name != NOTHING, name))
    outcomes = {x["named"] for x in lines} | {name for name in hidden if name != NOTHING}
    named = sorted(outcomes, key=lambda name: (name == UNKNOWN, name == NOTHING, name))
    count = np.zeros((len(hidden), len(named)), dtype=int)
    for line in lines:
        count[hidden.index(line["hidden"]), named.index(line["named"])] += line["cases"]
    share = count / count.sum(1, keepdims=True).clip(1)
    with plt.rc_context(fname=STYLE):
        figure, axis = plt.subplots(figsize=(2.5 + 0.32 * len(named), 1.6 + 0.26 * len(hidden)))
        axis.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        for i, j in zip(*np.nonzero(count), strict=True):
            colour = "white" if share[i, j] > 0.6 else "black"
            axis.text(j, i, str(count[i, j]), ha="center", va="center", fontsize=7, color=colour)
        axis.set_xticks(range(len(named)), named, rotation=90, fontsize=7)
        axis.set_yticks(range(len(hidden)), hidden, fontsize=7)
        axis.set(xlabel="named first", ylabel="hidden", title=title)
        axis.grid(False)
        _write(figure, path)


def _write(figure: Figure, path: Path) -> None:
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=110)
        plt.close(figure)
