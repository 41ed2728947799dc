"""Draw all columns of a log over time in one picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.logs.inspect.choice import Proposal
from deepkoco.logs.inspect.clock import stamps
from deepkoco.logs.inspect.survey import ColumnSurvey, Survey
from deepkoco.output.picture import Picture, house_style
from deepkoco.output.whole_file import whole_file

MOST = 24  # largest number of drawn columns
POINTS = 4000  # longer series are reduced to the lowest and highest value of each stretch


def draw_overview(survey: Survey, proposal: Proposal | None = None) -> Picture:
    """Draw every column that changes, proposed channels first, with gaps (grey) and resets of the clock (red)."""
    named = (
        {c.column.label: c for c in proposal.choices if c.column is not None} if proposal is not None else {}
    )
    moving = [c for c in survey.columns if c.kind == "number" and survey.clock(c) is not None]
    moving.sort(key=lambda column: column.label not in named)
    drawn = moving[:MOST]
    tables = []
    with house_style():
        figure = Figure(figsize=(8.0, 0.6 + 1.1 * max(len(drawn), 1)), layout="constrained")
        axes = figure.subplots(max(len(drawn), 1), 1, sharex=True, squeeze=False)[:, 0]
        for axis, column in zip(axes, drawn, strict=False):
            choice = named.get(column.label)
            t, value, resets = _along(survey, column)
            axis.plot(*_thin(t, value), linewidth=0.8)
            for at in resets:
                axis.axvline(at, color="tab:red", linewidth=0.8)
            for begin, end in _gaps(t):
                axis.axvspan(begin, end, color="0.85")
            unit = choice.unit if choice is not None else column.hints.unit or ""
            label = column.name if choice is None else f"{column.name}\n= {choice.channel.name}"
            axis.set_ylabel(
                f"{label}\n[{unit}]" if unit else label, rotation=0, ha="right", va="center", fontsize=7
            )
            tables.append(pd.DataFrame({"column": column.label, "time_s": t, "value": value}))
        axes[-1].set_xlabel("time [s]")
    caption = "Every column that changes. Grey: gaps. Red: resets of the clock; later samples are shifted behind them."
    table = (
        pd.concat(tables, ignore_index=True)
        if tables
        else pd.DataFrame(columns=["column", "time_s", "value"])
    )
    return Picture("overview", survey.log.path.name, caption, figure, table)


def save_picture(picture: Picture, path: Path) -> None:
    """Write the picture and the table of its data, NAME_data.csv; overwrite nothing.

    Args:
        picture: The picture.
        path: File of the picture; its suffix selects the format.

    Raises:
        FileExistsError: One of the two is there already.
        WriteError: The disk is full, or the place cannot be written.
        ValueError: The format is not known.
    """
    table = path.with_name(f"{path.stem}_data.csv")
    for target in (path, table):
        if target.exists():
            raise FileExistsError(f"{target}: exists; choose another name or move it away")
    for target in (path, table):
        with whole_file(target) as partial:
            if target is path:
                picture.figure.savefig(partial)
            else:
                picture.table.to_csv(partial, index=False)


def _along(survey: Survey, column: ColumnSurvey) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [s], values and times of resets of a column; stamps after a reset are shifted behind those before it."""
    clock = survey.clock(column)
    assert clock is not None
    t, value = stamps(survey.log, clock), survey.log.values(column.topic, column.name)
    good = np.isfinite(t) & (np.isfinite(value) | np.isnan(value))
    t, value = t[good], np.where(np.isfinite(value[good]), value[good], np.nan)
    step = np.diff(t)
    back = np.flatnonzero(step < 0)
    middle = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    moved = np.zeros(len(t))
    for k in back:
        moved[k + 1 :] += t[k] - t[k + 1] + middle
    return t + moved, value, (t + moved)[back + 1] if len(back) else np.zeros(0)


def _gaps(t: np.ndarray) -> list[tuple[float, float]]:
    step = np.diff(t)
    middle = float(np.median(step)) if len(step) else 0.0
    return (
        [(float(t[k]), float(t[k + 1])) for k in np.flatnonzero(step > 10 * middle)[:200]]
        if middle > 0
        else []
    )


def _thin(t: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if len(t) <= POINTS:
        return t, value
    pieces = np.array_split(np.arange(len(t)), POINTS // 2)
    keep = []
    for piece in pieces:
        finite = piece[np.isfinite(value[piece])]
        if len(finite):
            keep += sorted({int(finite[np.argmin(value[finite])]), int(finite[np.argmax(value[finite])])})
        else:
            keep.append(int(piece[0]))
    return t[keep], value[keep]
