"""How the pictures of a report look: two widths, and one colour and name per model in all of them."""

from __future__ import annotations

from typing import NamedTuple

from deepkoco.diagnose.diagnosis import Diagnosis

COLOURS = {"measured": "#222222", "baseline": "#8a8a8a", "refit": "#3b7dd8", "extended": "#e4572e"}
LABELS = {
    "baseline": "simulation as given",
    "refit": "simulation, parameters refitted",
    "extended": "simulation with the named cause",
}


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
        """Rows and columns for so many panels."""
        columns = min(panels, self.columns)
        return -(-panels // columns), columns


DESKTOP = Layout(9.0, 4, 5)
PHONE = Layout(4.1, 1, 1)


def shown_models(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Models that the pictures compare: the extended one where something is named."""
    named = bool(diagnosis.names) and diagnosis.verdict != "unknown"
    return ("baseline", "refit", "extended") if named else ("baseline", "refit")
