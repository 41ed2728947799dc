"""Metrics of a run: a CSV that is always whole, and TensorBoard events made from the same rows."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from torch.utils.tensorboard import SummaryWriter

from deepkoco.agent.collection import cost_spread
from deepkoco.koopman.exported import Array
from deepkoco.output.whole_file import write_whole_text, writing

Row = dict[str, float]


def write_rows(path: Path, rows: list[Row]) -> None:
    """Write rows as a CSV so that a kill at any moment leaves the old or the new file, whole.

    Args:
        path: Target file.
        rows: At least one; what a row lacks, as those of an older release may, is NaN.

    Raises:
        WriteError: The disk is full, or the place cannot be written.
    """
    text = io.StringIO()
    names = dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(text, fieldnames=list(names), restval="nan", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole_text(path, text.getvalue())


def evaluation_metrics(costs: Array, episodes: int) -> Row:
    """What every agent says of an evaluation.

    Args:
        costs: Of its episodes (n,).
        episodes: How many there were; 0 for none.
    """
    return {
        "evaluation/cost": float(costs.mean()),
        "evaluation/cost_sd": cost_spread(costs),
        "evaluation/cost_median": float(np.median(costs)),
        "evaluation/episodes": episodes,
    }


class MetricsLog:
    """One row per training iteration.

    The rows belong to the checkpoint; a resumed run starts from the rows it had then, rewrites the CSV and
    makes the event file anew, so no step appears twice.
    """

    def __init__(self, folder: Path, rows: list[Row]) -> None:
        """Open the log.

        Args:
            folder: The run's folder.
            rows: Rows of the checkpoint, or none.
        """
        self.rows = list(rows)
        self._path = folder / "metrics.csv"
        self._events = folder / "tensorboard"
        for old in self._events.glob("events.out.tfevents.*"):
            old.unlink()
        with writing(self._events):
            self._writer = SummaryWriter(str(self._events))
        for row in self.rows:
            self._write_events(row)
        if self.rows:
            write_rows(self._path, self.rows)

    def add(self, row: Row, clock: Row | None = None) -> None:
        """Append a row; every row has the same keys, `episodes` is the x-axis.

        Args:
            row: Name to value.
            clock: Measurements of the wall clock: events only, for no other run would repeat them.
        """
        self.rows.append(row)
        self._write_events({**row, **(clock or {})})
        write_rows(self._path, self.rows)

    def close(self) -> None:
        """Flush the events."""
        self._writer.close()

    def _write_events(self, row: Row) -> None:
        with writing(self._events):
            for name, value in row.items():
                self._writer.add_scalar(name, value, global_step=int(row["episodes"]))
            self._writer.flush()
