"""Widths of the pictures of a report, and the colour and the label of each simulation in all of them."""

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
    """Size of the pictures.

    Attributes:
        width: Width of a picture [inch].
        columns: Largest number of panels in a row.
        entries: Largest number of legend entries in a row.
    """

    width: float
    columns: int
    entries: int

    def grid(self, panels: int) -> tuple[int, int]:
        """Return rows and columns for this number of panels, in rows of equal length where possible."""
        most = min(self.columns, max(int(self.width / PANEL_INCHES), 1))
        rows = -(-panels // most)
        return rows, -(-panels // rows)


DESKTOP = Layout(9.0, 4, 5)
PHONE = Layout(4.1, 1, 1)


def shown_models(diagnosis: Diagnosis) -> dict[str, str]:
    """Return the simulations compared on fitted windows -> label; the extended one only where a cause is named."""
    named = bool(diagnosis.names) and diagnosis.verdict != "unknown"
    return {name: label for name, label in LABELS.items() if named or name != "extended"}


def held_out_models(diagnosis: Diagnosis) -> dict[str, str]:
    """Return the simulations compared on held-out windows -> label.

    A learned load can take the place of a cause, and so can the unit as it is after a change in the middle of its log.
    """
    models = shown_models(diagnosis)
    if diagnosis.verdict == "unknown" and "changed_midway" in diagnosis.unexplained:
        models["extended"] = "simulation of the unit after its change"
    if learned_load(diagnosis):
        models["extended"] = "simulation with a learned load"
    return models


def learned_load(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Return the learned load that was added instead of a cause, as in report.json; None where there is none."""
    found = diagnosis.unexplained.get("residual_model")
    return found if diagnosis.verdict == "unknown" and found and found["accepted"] else None
