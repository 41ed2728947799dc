"""Histograms of the time between samples and between commands, with fitted mixtures."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.report.figures.layout import COLOURS, Layout
from deepkoco.graph.delay import Mixture
from deepkoco.graph.episodes.fitting.mixture_fit import fit_mixture
from deepkoco.output.picture import Picture

BINS = 60
MIN_INTERVALS = 50  # intervals that a histogram needs
REGULAR = 4e-3  # standard deviation over the median, below which the times count as regular and are not drawn
COMPONENTS = 4  # of a mixture, at most
SHOWN = (0.005, 0.995)  # quantiles between which the histogram is drawn


def timing(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture | None:
    """Draw the time between successive samples and successive commands; None where all are regular."""
    found = {
        name: spacing
        for name, spacing in _spacings(details).items()
        if len(spacing) >= MIN_INTERVALS and float(spacing.std()) > REGULAR * float(np.median(spacing))
    }
    if not found:
        return None
    rows, columns = layout.grid(len(found))
    figure = Figure(figsize=(layout.width, 0.8 + 2.5 * rows))
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    tables = []
    for axis, (name, spacing) in zip(axes, found.items(), strict=False):
        low, high = np.quantile(spacing, SHOWN)
        edges = np.linspace(low, max(high, low * (1.0 + 1e-6)), BINS + 1)
        law = fit_mixture(spacing, COMPONENTS)
        count, _ = np.histogram(spacing, edges)
        fitted = len(spacing) * np.diff(law.cdf(edges))
        middle = 500.0 * (edges[:-1] + edges[1:])
        axis.stairs(count, 1e3 * edges, fill=True, color=COLOURS["baseline"], alpha=0.6, label="log")
        parts = len(law.components) if isinstance(law, Mixture) else 1
        axis.plot(middle, fitted, color=COLOURS["refit"], label="fitted mixture")
        axis.set_xlabel(f"time between {name} [ms]")
        axis.xaxis.set_major_locator(MaxNLocator(4))
        axis.set_title(
            f"mean {1e3 * spacing.mean():.3g} ms, spread {1e3 * spacing.std():.2g} ms, "
            f"{parts} part{'s' if parts > 1 else ''}",
            fontsize=9,
        )
        tables.append(pd.DataFrame({"of": name, "middle_ms": middle, "count": count, "mixture": fitted}))
    for axis in axes[len(found) :]:
        axis.set_visible(False)
    axes[0].set_ylabel("how many")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    caption = (
        "Time between successive messages of the log. A regular clock gives one narrow peak. A busy computer or a "
        "loaded bus gives several peaks or a long tail. The curve is a fitted mixture, from which a simulation can "
        "draw delays. The smallest and the largest half per cent are not shown."
    )
    return Picture("timing", "The timing of the log", caption, figure, pd.concat(tables))


def _spacings(details: Details) -> dict[str, np.ndarray]:
    """Times between neighbours [s] of the commands, and of the samples of each channel with its own time stamps."""
    commands = [np.diff(series.t) for series in details.windows.commands]
    found = {"commands": np.concatenate(commands) if commands else np.zeros(0)}
    windows = details.windows
    for c, (name, _) in enumerate(details.channels):
        parts = []
        for w in range(len(windows)):
            t = windows.t[w, c].numpy()[windows.valid[w, c].numpy()]
            parts.append(np.diff(t))
        spacing = np.concatenate(parts) if parts else np.zeros(0)
        if not any(len(spacing) == len(other) and np.allclose(spacing, other) for other in found.values()):
            found[f"samples of {name}"] = spacing
    return {name: spacing[spacing > 0.0] for name, spacing in found.items()}
