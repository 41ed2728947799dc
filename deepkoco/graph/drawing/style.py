"""What all pictures share: one style, one colour per node, a PNG and the numbers behind it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import IO, NamedTuple

import matplotlib
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.graph.model.graph import Graph
from deepkoco.output.whole_file import whole_file, writing

# Told apart by people who do not see all colours: Okabe and Ito's set, the light yellow darkened; then Tol's.
PALETTE = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#a89f00", "#332288",
    "#882255", "#44aa99", "#999933", "#aa4499", "#117733", "#6699cc", "#661100", "#888888",
)  # fmt: skip
INK, QUIET, ALARM = "#222222", "#8a8a8a", "#d62828"


class DrawingError(ValueError):
    """A picture cannot be drawn or saved; the message says why."""


class Picture(NamedTuple):
    """A figure and the table of what it draws.

    Attributes:
        name: file stem.
        figure: matplotlib figure, not attached to any window.
        table: one row for each thing drawn, units in the column names.
    """

    name: str
    figure: Figure
    table: pd.DataFrame

    def save(self, folder: str | Path, name: str | None = None) -> tuple[Path, Path]:
        """Write `NAME.png` and `NAME.csv`, each whole or not at all.

        Args:
            folder: where to; made if it is not there.
            name: file stem; None takes the picture's.

        Returns:
            The two paths.

        Raises:
            DrawingError: one of the files exists.
            WriteError: the disk is full, or the place cannot be written.
        """
        folder = Path(folder)
        png, csv = (folder / f"{name or self.name}{suffix}" for suffix in (".png", ".csv"))
        for path in (png, csv):
            if path.exists():
                raise DrawingError(f"{path}: exists; choose another name or move it away")
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        # Without the version of matplotlib in the file, the same picture is the same bytes.
        write_whole(png, lambda file: self.figure.savefig(file, format="png", metadata={"Software": None}))
        write_whole(csv, lambda file: file.write(self.table.to_csv(index=False).encode()))
        return png, csv


def write_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file with `write`, whole or not at all.

    Raises:
        WriteError: the disk is full, or the place cannot be written.
    """
    with whole_file(path) as partial, partial.open("xb") as file:
        write(file)


@contextmanager
def figure_style() -> Iterator[None]:
    """Draw in the style of all figures of the package."""
    with matplotlib.rc_context(fname=str(files("deepkoco.output").joinpath("figures.mplstyle"))):
        yield


def colours(graph: Graph) -> dict[str, str]:
    """Colour of each node, the same in every picture of a graph."""
    return {node.name: PALETTE[n % len(PALETTE)] for n, node in enumerate(graph.nodes)}
