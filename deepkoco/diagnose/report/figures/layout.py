"""How the pictures of a report look: two widths, and one colour and name per model in all of them."""

from __future__ import annotations

from typing import Any, NamedTuple

from deepkoco.diagnose.diagnosis import Diagnosis

COLOURS = {"measured": "#222222", "baseline": "#8a8a8a", "refit": "#3b7dd8", "extended": "#e4572e"}
LABELS = {
    "baseline": "simulation as given",
    "refit": "simulation, parameters refitted",
    "extended": "simulation with the named cause",
}


PANEL_INCHES = 2.9  # least width of a panel, so that the labels of neighbours do not meet


class Layout(NamedTuple):
    """Room that the pictures have.

    Attributes:
        width: Of a picture [inch].
        columns: Panels beside each other, at most.
        entries: Of a legend beside each other, at most.
    """

    width: float
    columns: int
    entries: int

    def grid(self, panels: int) -> tuple[int, int]:
        """Rows and columns for so many panels, in rows of equal length where that can be."""
        most = min(self.columns, max(int(self.width / PANEL_INCHES), 1))
        rows = -(-panels // most)
        return rows, -(-panels // rows)


DESKTOP = Layout(9.0, 4, 5)
PHONE = Layout(4.1, 1, 1)


def shown_models(diagnosis: Diagnosis) -> dict[str, str]:
    """Models that the pictures compare on the fitted windows -> label: the extended one where something is named."""
    named = bool(diagnosis.names) and diagnosis.verdict != "unknown"
    return {name: label for name, label in LABELS.items() if named or name != "extended"}


def held_out_models(diagnosis: Diagnosis) -> dict[str, str]:
    """Models that are compared on windows kept back -> label: a learned load stands where no cause is named."""
    models = shown_models(diagnosis)
    if learned_load(diagnosis):
        models["extended"] = "simulation with a learned load"
    return models


def learned_load(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """The residual model that was added in place of a cause, as in report.json; None where there is none."""
    found = diagnosis.unexplained.get("residual_model")
    return found if diagnosis.verdict == "unknown" and found and found["accepted"] else None
