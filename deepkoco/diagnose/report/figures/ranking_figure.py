"""Which cause explains the log: every candidate, ranked."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.report.figures.layout import COLOURS, Layout
from deepkoco.diagnose.report.text import spoken
from deepkoco.output.picture import Picture

MOST_BARS = 24
OTHERS = "#b9b9b9"


def candidates(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture:
    """Ranked candidates as bars of delta BIC."""
    names = [c.name for c in diagnosis.candidates]
    score = np.array([c.delta_bic for c in diagnosis.candidates])
    table = pd.DataFrame(
        {"cause": names, "family": [c.family for c in diagnosis.candidates], "delta_bic": score}
    )
    shown = min(len(names), MOST_BARS)
    named = set(diagnosis.causes[0].members) if diagnosis.causes else set()
    figure = Figure(figsize=(layout.width, 0.27 * shown + 1.3))
    axis = figure.subplots()
    colours = [COLOURS["extended"] if n in named else OTHERS for n in names[:shown]]
    axis.barh(range(shown), score[:shown], color=colours)
    spoken_names = [spoken(n) for n in names[:shown]]
    axis.set_yticks(range(shown), spoken_names)
    axis.set_ylim(shown - 0.4, -1.3)
    axis.set_xscale("symlog", linthresh=10.0)
    # Decades from ten on, and no more than fit side by side.
    top = max(float(score.max(initial=0.0)), 100.0)
    ticks = [0.0, *(10.0**k for k in range(1, int(np.ceil(np.log10(top))) + 1))]
    if score[:shown].min(initial=0.0) < -5.0:
        ticks = [-10.0, *ticks]
    every = -(-len(ticks) // max(int((layout.width - 1.9) / 0.7), 1))
    thinned = [t for k, t in enumerate(ticks) if (k - ticks.index(0.0)) % every == 0]
    axis.set_xticks(thinned, [f"{t:,.0f}" for t in thinned])
    axis.axvline(diagnosis.detection, color="#222222", lw=1, ls="--")
    axis.text(
        diagnosis.detection, -0.9, " least evidence to be named", fontsize=8, va="center", color="#222222"
    )
    for place, value in enumerate(score[:shown]):
        axis.text(max(value, 0.0), place, f" {value:,.0f}", fontsize=8, va="center")
    axis.set_xlim(right=top * 10.0**1.5)
    axis.set_xlabel("evidence (fall of the BIC)")
    axis.grid(axis="y", visible=False)
    caption = (
        "Every cause of the catalogue was tried on the same windows. The longer its bar to the right, the better the "
        "cause explains the log beyond what its extra parameters cost (mind the logarithmic scale); bars left of zero "
        "explain nothing. "
    )
    if named:
        caption += (
            "The coloured bar was named: it explains the most. Grey bars beyond the dashed line explain part of the "
            "same, and nothing more once the named cause is in the simulation."
            if len(named) == 1
            else "Coloured bars are causes that these data do not tell apart. Grey bars beyond the dashed line explain "
            "part of the same, and less."
        )
    else:
        caption += "None was named: a cause must pass the dashed line and explain what the refit leaves."
    if len(names) > shown:
        caption += f" The {len(names) - shown} weakest are left out here."
    return Picture("candidates", "Which cause explains it", caption, figure, table)
