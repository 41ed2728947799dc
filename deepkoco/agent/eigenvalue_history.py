"""How the eigenvalues moved during a run: a CSV that is always whole."""

from __future__ import annotations

from pathlib import Path

from torch import Tensor

from deepkoco.agent.metrics import Row, write_rows

EIGENVALUE_FILE = "eigenvalues.csv"


class EigenvalueHistory:
    """Growth rates and frequencies of the acting model, one row before training and one per iteration.

    The rows belong to the checkpoint, so a resumed run writes the same file as an uninterrupted one.

    Attributes:
        rows: `episodes`, then mu_1 .. mu_P [1/s] and omega_1 .. omega_P [rad/s].
    """

    def __init__(self, folder: Path, rows: list[Row]) -> None:
        """Open the history.

        Args:
            folder: The run's folder.
            rows: Rows of the checkpoint, or none.
        """
        self.rows = list(rows)
        self._path = folder / EIGENVALUE_FILE
        if self.rows:
            write_rows(self._path, self.rows)

    def add(self, episodes: int, mu: Tensor, omega: Tensor) -> None:
        """Append a row and write the file.

        Args:
            episodes: Training episodes so far.
            mu: Growth rates (P,) [1/s].
            omega: Frequencies (P,) [rad/s].
        """
        row: Row = {"episodes": episodes}
        for name, values in (("mu", mu), ("omega", omega)):
            row |= {f"{name}_{i}": value for i, value in enumerate(values.tolist(), 1)}
        self.rows.append(row)
        write_rows(self._path, self.rows)
