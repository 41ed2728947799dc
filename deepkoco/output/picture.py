"""What a report shows: a figure with its heading, how to read it and the table behind it, all in one style."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from typing import NamedTuple

import matplotlib
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class Picture(NamedTuple):
    """One figure of a report.

    Attributes:
        name: File stem.
        title: Heading.
        caption: A sentence or two on how to read it.
        figure: The drawing.
        table: What it draws, units in the column names.
    """

    name: str
    title: str
    caption: str
    figure: Figure
    table: pd.DataFrame


@contextmanager
def house_style() -> Iterator[None]:
    """The project's style for all figures made inside."""
    with matplotlib.rc_context(fname=str(files("deepkoco.output").joinpath("figures.mplstyle"))):
        yield


@contextmanager
def laid_out(figure: Figure) -> Iterator[None]:
    """Lay a figure out once for all its drawings inside.

    Matplotlib draws a figure that lays itself out twice each time that it is saved, and the first drawing is for the
    layout alone.
    """
    engine = figure.get_layout_engine()
    if engine is None:
        yield
        return
    FigureCanvasAgg(figure)
    with house_style():
        engine.execute(figure)
    figure.set_layout_engine("none")
    try:
        yield
    finally:
        figure.set_layout_engine(engine)


def as_png(figure: Figure) -> bytes:
    """A figure as PNG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    with house_style(), laid_out(figure):
        figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    return buffer.getvalue()
