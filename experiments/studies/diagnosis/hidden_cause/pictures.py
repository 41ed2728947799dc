"""Picture of the benchmark: every column, one bar for each entrant, with its interval."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from deepkoco.output.whole_file import whole_file
from experiments.studies.diagnosis.hidden_cause.columns import MEDIANS, SHARES

STYLE = str(files("deepkoco.output").joinpath("figures.mplstyle"))
UNITS = {"seconds": "s, logarithmic", "held-out error / as given": "ratio, logarithmic"}
BETTER = {"top-1 in class": "more is better", "outside right": "more is better"}


def draw_columns(found: Mapping[str, Mapping[str, Mapping[str, Any]]], path: Path) -> None:
    """Draw all columns.

    Args:
        found: As given by :func:`columns`.
        path: PNG to write, all or nothing.
    """
    names, entrants = [*SHARES, *MEDIANS], list(found)
    with plt.rc_context(fname=STYLE):
        colours = plt.rcParams["axes.prop_cycle"].by_key()["color"]
        height = 1.1 + 0.32 * len(entrants)
        figure, axes = plt.subplots(1, len(names), figsize=(2.5 * len(names), height), sharey=True)
        for axis, name in zip(np.atleast_1d(axes), names, strict=True):
            for k, entrant in enumerate(entrants):
                own = found[entrant][name]
                value = own.get("value", own.get("share"))
                if value is None:
                    axis.text(
                        0.02, k, "no case", transform=axis.get_yaxis_transform(), va="center", fontsize=7
                    )
                    continue
                low, high = own["low"], own["high"]
                error = np.nan_to_num([[max(value - low, 0.0)], [max(high - value, 0.0)]], posinf=0.0)
                axis.barh(k, value, color=colours[k % len(colours)], height=0.7)
                axis.errorbar(value, k, xerr=error, color="black", capsize=2, linewidth=0.8)
            axis.set_yticks(range(len(entrants)), entrants)
            if name in UNITS:
                axis.set_xscale("log")
            else:
                axis.set_xlim(0.0, 1.02)
            unit = UNITS.get(name, "share")
            axis.set_xlabel(f"{unit}; {BETTER.get(name, 'less is better')}", fontsize=7)
            axis.set_title(name, fontsize=8)
        axes_ = np.atleast_1d(axes)
        axes_[0].invert_yaxis()
        with whole_file(path) as partial:
            figure.savefig(partial, dpi=110)
            plt.close(figure)
