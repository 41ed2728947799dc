"""What every analysis hands to the page: a figure, the table behind it and how to read it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from typing import NamedTuple

import matplotlib
import pandas as pd
from matplotlib.figure import Figure

# One colour per method in every figure.
COLOURS = {
    "DeepKoCo": "#e4572e",
    "EDMDc": "#3b7dd8",
    "reference": "#2f9e6e",
    "measured": "#222222",
    "muted": "#9a9a9a",
}
SIGNED = "RdBu_r"
MAGNITUDE = "viridis"
PHASE = "twilight"


class Picture(NamedTuple):
    """One figure of the page: file stem, title, two sentences for the reader, drawing and its data."""

    name: str
    title: str
    caption: str
    figure: Figure
    table: pd.DataFrame


@contextmanager
def house_style() -> Iterator[None]:
    """The project's style for all figures made inside."""
    with matplotlib.rc_context(fname=str(files("deepkoco").joinpath("figures.mplstyle"))):
        yield
