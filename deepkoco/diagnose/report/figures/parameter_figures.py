"""Parameters with their intervals: those of the named causes, and the simulation's own."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.report.figures.layout import COLOURS, Layout, shown_models
from deepkoco.diagnose.report.text import spoken
from deepkoco.output.picture import Picture
from deepkoco.pages.units import readable


def found_parameters(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture | None:
    """Each parameter of the named causes on an axis of its own, with its null value."""
    declared = {p.name: p for p in details.system.parameters}
    rows = []
    for cause in diagnosis.causes:
        for name, e in cause.parameters.items():
            if e.low == e.high:  # one of a few shapes that were tried, not a size
                continue
            null = declared[name].value if name in declared else float("nan")
            rows.append((name, null, e.value, e.low, e.high, e.unit))
    if not rows:
        return None
    table = pd.DataFrame(rows, columns=["parameter", "null", "value", "low", "high", "unit"])
    figure = Figure(figsize=(layout.width, 1.15 * len(rows) + 0.6))
    axes = figure.subplots(len(rows), 1, squeeze=False)[:, 0]
    for axis, (name, null, value, low, high, unit) in zip(axes, rows, strict=True):
        axis.plot([low, high], [0.0, 0.0], color=COLOURS["extended"], lw=5, alpha=0.4, solid_capstyle="butt")
        axis.plot(value, 0.0, "o", color=COLOURS["extended"], label="found, 95 % interval")
        axis.plot(null, 0.0, "|", color=COLOURS["measured"], markersize=16, label="simulation as given")
        heading = _heading(name, value, unit)
        axis.set_title(heading, loc="left", fontsize=10)
        axis.set_ylim(-1.0, 1.0)
        axis.margins(x=0.12)
        axis.set_yticks([])
        axis.spines["left"].set_visible(False)
        axis.grid(axis="y", visible=False)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=min(2, layout.entries)
    )
    caption = (
        "Size of what was found, with the interval that holds the true value in 95 of 100 cases. The mark is the "
        "value at which the simulation is what it was; the further the interval is from it, the surer the finding."
    )
    return Picture("found_parameters", "How large it is", caption, figure, table)


def own_parameters(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture:
    """Parameters of the model that is written against what the simulation assumed, with intervals."""
    rows = []
    for name, e in diagnosis.final.items():
        centre, sd = details.priors[name]
        refit = diagnosis.refit[name]
        rows.append((name, centre, sd, e.value, e.low, e.high, e.unit, refit.value, refit.low, refit.high))
    columns = ["parameter", "assumed", "prior_sd", "value", "low", "high", "unit"]
    table = pd.DataFrame(rows, columns=[*columns, "refit", "refit_low", "refit_high"])
    row = 0.32 if layout.columns > 1 else 0.5
    figure = Figure(figsize=(layout.width, row * len(rows) + 1.2))
    axis = figure.subplots()
    shift = (table["value"] - table["assumed"]) / table["prior_sd"]
    low, high = ((table[k] - table["assumed"]) / table["prior_sd"] for k in ("low", "high"))
    named = "extended" in shown_models(diagnosis)
    axis.axvspan(-2, 2, color="#000000", alpha=0.06, lw=0)
    axis.axvline(0.0, color=COLOURS["measured"], lw=1)
    axis.errorbar(
        shift,
        range(len(rows)),
        xerr=[shift - low, high - shift],
        fmt="o",
        color=COLOURS["extended" if named else "refit"],
        capsize=3,
    )
    between = " = " if layout.columns > 1 else "\n"
    axis.set_yticks(range(len(rows)), [f"{spoken(r[0])}{between}{readable(r[3], r[6], 4)}" for r in rows])
    axis.set_ylim(-0.6, len(rows) - 0.4)
    axis.invert_yaxis()
    axis.set_xlabel("shift [standard deviations]")
    caption = (
        "How far the parameters of model.yaml are from what the simulation assumed, with 95 % intervals. Zero is the "
        "value of the simulation as given; the grey band (two standard deviations) is what a data sheet usually leaves "
        "open. An interval that fills the band means that the log says little about this parameter."
    )
    if named:
        caption += " They were fitted together with the named cause."
    return Picture("parameters", "How far the parameters moved", caption, figure, table)


def _heading(name: str, value: float, unit: str) -> str:
    cause, _, parameter = name.rpartition(".")
    label = f"{spoken(cause)}, {spoken(parameter)}" if cause else spoken(parameter)
    return f"{label}: {readable(value, unit, 4)}"
