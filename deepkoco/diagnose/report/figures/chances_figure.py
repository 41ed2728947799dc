"""Probabilities of what may stand in the place of each named cause, or of nothing."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.report.figures.layout import COLOURS, Layout
from deepkoco.diagnose.report.figures.ranking_figure import OTHERS
from deepkoco.diagnose.report.text import candidate
from deepkoco.output.picture import Picture


def probabilities(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture | None:
    """Draw the probabilities as bars, one group for each named cause."""
    places = [(c.name, c.probabilities) for c in diagnosis.causes if c.probabilities]
    if diagnosis.verdict == "nothing" and diagnosis.probabilities:
        places = [("nothing", diagnosis.probabilities)]
    if not places:
        return None
    rows = [
        {"place": k + 1, "candidate": candidate(name), "probability": p, "named": name == leader}
        for k, (leader, chances) in enumerate(places)
        for name, p in chances.items()
    ]
    table = pd.DataFrame(rows)
    # Half a bar is free between two groups.
    at = [k + 0.5 * (row["place"] - 1) for k, row in enumerate(rows)]
    figure = Figure(figsize=(layout.width, 0.3 * (at[-1] + 1.0) + 0.9))
    axis = figure.subplots()
    colours = [COLOURS["extended"] if row["named"] else OTHERS for row in rows]
    axis.barh(at, table["probability"], color=colours)
    axis.set_yticks(at, table["candidate"])
    axis.invert_yaxis()
    for place, value in zip(at, table["probability"], strict=True):
        axis.text(value, place, f" {value:.2f}", fontsize=8, va="center")
    axis.set_xlim(0.0, 1.12)
    axis.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0])
    axis.set_xlabel("probability")
    axis.grid(axis="y", visible=False)
    named = diagnosis.verdict != "nothing"
    caption = (
        "The coloured bar is what is named. The other bars are what may stand in its place, by this log and by what is "
        f'known of the robot. "{candidate("unknown")[0].upper()}{candidate("unknown")[1:]}" is a cause that is not in '
        "the catalogue."
    )
    if named and len(places) > 1:
        caption += " Each group is one named cause; the others stay in the simulation meanwhile."
    return Picture("probabilities", "How probable it is", caption, figure, table)
