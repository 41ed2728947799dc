"""Bring a wide figure into the width of a phone: its panels go below each other."""

from __future__ import annotations

import textwrap

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.transforms import Bbox

PHONE_INCHES = 4.1
"""Width at which letters of 10 points are as large on a phone as the text around them."""
_LETTERS = 48  # of a legend that has room in one row
_MOST_ROWS = 12  # panels below each other; more of them stay beside each other


def narrow(figure: Figure, width: float = PHONE_INCHES) -> None:
    """Change a figure in place.

    Panels of a grid go below each other, small ones (of grids with many columns) a few in a row; each keeps about
    its shape. Tick labels and axis labels that a shared axis had hidden come back where a row or column begins, and
    labels that are longer than their axis are broken into lines.

    Args:
        figure: With at most one grid of panels; colour bars stay with their panels.
        width: New width [inch].
    """
    wide, high = figure.get_size_inches()
    if wide <= width:
        return
    panels = [axes for axes in figure.axes if axes.get_subplotspec() is not None]
    bars = [axes for axes in figure.axes if axes.get_subplotspec() is None]
    rows, columns = _shape(panels)
    across = _columns(rows, columns, panels, bars)
    if across < columns:
        high = _rearranged(figure, panels, rows, columns, across, wide, high, width)
        for bar in bars:
            _beside(bar)
    extra = sum(_narrow_legend(figure, legend) for legend in list(figure.legends))
    figure.set_size_inches(width, high + extra)
    figure.draw_without_rendering()  # to see how much room the panels have
    for panel in panels:
        box = panel.get_window_extent()
        for label in (panel.xaxis.label, panel.title):
            centre = 0.5 * (box.x0 + box.x1)
            _wrap(label, label.get_window_extent().width, 2.0 * min(centre, figure.bbox.width - centre))
        _wrap(panel.yaxis.label, panel.yaxis.label.get_window_extent().height, 1.1 * box.height)


def _shape(panels: list[Axes]) -> tuple[int, int]:
    specs = [spec for panel in panels if (spec := panel.get_subplotspec()) is not None]
    if not specs:
        return 1, 1
    return specs[0].get_gridspec().get_geometry()


def _columns(rows: int, columns: int, panels: list[Axes], bars: list[Axes]) -> int:
    """Panels in a row of the narrow figure: one, or as many as keep it from becoming endless.

    Panels that share a colour bar stay in one row, unless it belongs to all.
    """
    shared = [_columns_of(bar) for bar in bars if len(_parents(bar)) < len(panels)]
    for across in range(1, columns + 1):
        together = all(min(own) // across == max(own) // across for own in shared if own)
        if columns % across == 0 and rows * (columns // across) <= _MOST_ROWS and together:
            return across
    return columns


def _parents(bar: Axes) -> list[Axes]:
    """The panels of a colour bar; none for other axes."""
    return list(getattr(bar, "_colorbar_info", {}).get("parents", ()))


def _columns_of(bar: Axes) -> list[int]:
    specs = [spec for panel in _parents(bar) if (spec := panel.get_subplotspec()) is not None]
    return [spec.colspan.start for spec in specs]


def _beside(bar: Axes) -> None:
    """Put a colour bar to the right of where its panels are now; the layout engine starts from there."""
    if parents := _parents(bar):
        box = Bbox.union([panel.get_position(original=True) for panel in parents])
        start = box.x0 + 0.9 * box.width
        bar._set_position((start, box.y0, 0.05 * box.width, box.height))  # pyright: ignore[reportAttributeAccessIssue]


def _narrow_legend(figure: Figure, legend: Legend) -> float:
    """Put a legend above the figure, its entries below each other unless they are short; returns its growth [inch]."""
    texts = [text.get_text() for text in legend.get_texts()]
    size = float(legend.get_texts()[0].get_fontsize()) if texts else 9.0
    if sum(len(text) + 6 for text in texts) <= _LETTERS:
        return 0.0
    handles = [handle for handle in legend.legend_handles if handle is not None]
    figure.legend(handles, texts, loc="outside upper center", ncols=1, fontsize=size, frameon=False)
    legend.remove()
    return 0.2 * (sum(text.count("\n") + 1 for text in texts) - 1)


def _wrap(label: Text, length: float, room: float) -> None:
    """Break a label of some length into lines that have room; both in pixels."""
    if length > room:
        longest = max(len(line) for line in label.get_text().splitlines())
        letters = max(int(0.97 * longest * room / length), 8)
        label.set_text("\n".join(textwrap.fill(line, letters) for line in label.get_text().splitlines()))


def _rearranged(
    figure: Figure,
    panels: list[Axes],
    rows: int,
    columns: int,
    across: int,
    wide: float,
    high: float,
    width: float,
) -> float:
    """Put the panels into the new grid; returns the figure's new height [inch]."""
    parts = columns // across
    grid = GridSpec(rows * parts, across, figure=figure)
    labels: dict[int, str] = {}
    for panel in panels:
        spec = panel.get_subplotspec()
        assert spec is not None
        row, column = spec.rowspan.start, spec.colspan.start
        if column == 0:
            labels[row] = panel.get_ylabel()
        new_row, new_column = row * parts + column // across, column % across
        panel.set_subplotspec(grid[new_row, new_column])
        panel.tick_params(labelbottom=panel.xaxis.get_visible(), bottom=True)
        if new_column == 0:
            panel.tick_params(labelleft=True)
            if not panel.get_ylabel():
                panel.set_ylabel(labels.get(row, ""), fontsize=panel.yaxis.label.get_fontsize())
    share = (width / across) / (wide / columns)  # how much wider a panel becomes
    return rows * parts * max(high / rows * min(share, 1.0), 1.1)
