"""Figures on a page: they take the page's colours, share no identifiers, and have a form for phones."""

import re
import warnings
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from deepkoco.output.picture import Picture, house_style
from deepkoco.pages import as_svg, show_both
from deepkoco.pages.colours import ON_DARK, colour_css, variable_of
from deepkoco.pages.reflow import PHONE_INCHES, narrow


def drawn(columns: int = 2, **options) -> Figure:
    with house_style():
        figure = Figure(figsize=(9.0, 3.6))
        panels = figure.subplots(1, columns, squeeze=False, **options)[0]
        for panel in panels:
            panel.plot(np.arange(50), np.arange(50), ".", color="#3b7dd8", label="dots")
            panel.plot([0, 50], [0, 50], color="#222222", label="line")
            panel.set(xlabel="time [s]")
        panels[0].set(ylabel="0.123456 & more")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def test_colours_of_a_figure_become_those_of_the_page():
    svg = as_svg(drawn(), "one", "a figure")
    assert "var(--plot-blue)" in svg
    assert "var(--plot-grid)" in svg
    assert not set(re.findall(r"#[0-9a-f]{6}\b", svg)) & set(ON_DARK)
    assert variable_of("#000000") == variable_of("#222222") == "var(--plot-ink)"
    assert variable_of("#123456") is None


def test_every_colour_has_a_value_for_light_and_for_dark_pages():
    light, dark = colour_css().split("@media (prefers-color-scheme: dark)")
    names = [name for name, _ in ON_DARK.values()]
    assert len(set(names)) == len(names)
    for colour, (name, on_dark) in ON_DARK.items():
        assert f"--plot-{name}: {colour};" in light
        assert f"--plot-{name}: {on_dark};" in dark


def test_two_figures_of_a_page_share_no_identifier_and_refer_to_their_own():
    svgs = [as_svg(drawn(), name, "") for name in ("one", "two")]
    found = [set(re.findall(r'\bid="([^"]+)"', svg)) for svg in svgs]
    assert found[0]
    assert not found[0] & found[1]
    for svg, own in zip(svgs, found, strict=True):
        used = set(re.findall(r'href="#([^"]+)"', svg)) | set(re.findall(r"url\(#([^)]+)\)", svg))
        assert used == own


def test_text_stays_text_with_all_its_digits_and_in_the_font_of_the_page():
    svg = as_svg(drawn(), "one", 'a "figure" & <more>')
    root = ElementTree.fromstring(svg)
    texts = {"".join(element.itertext()).strip() for element in root.iter("text")}
    assert {"time [s]", "0.123456 & more", "dots"} <= texts
    assert "font-family" not in svg
    assert root.get("aria-label") == 'a "figure" & <more>'


def test_the_same_figure_gives_the_same_text():
    assert as_svg(drawn(), "one", "") == as_svg(drawn(), "one", "")


def test_dots_say_their_style_once():
    svg = as_svg(drawn(1), "one", "")
    (group,) = (g for g in ElementTree.fromstring(svg).iter("g") if len(g.findall("use")) == 50)
    assert "var(--plot-blue)" in group.get("style")
    assert not any(mark.get("style") for mark in group)


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_panels_go_below_each_other_on_a_phone(columns):
    figure = drawn(columns, sharey=True)
    narrow(figure)
    assert figure.get_figwidth() == PHONE_INCHES
    figure.draw_without_rendering()
    boxes = [panel.get_position() for panel in figure.axes]
    assert all(above.y0 > below.y1 for above, below in pairwise(boxes))
    for panel in figure.axes:
        assert panel.get_position().width > 0.6
        assert panel.get_ylabel() == "0.123456 & more"
        assert any(label.get_visible() and label.get_text() for label in panel.get_yticklabels())


def test_many_small_panels_stay_a_few_in_a_row_and_keep_their_colour_bars():
    with house_style():
        figure = Figure(figsize=(10.0, 8.0))
        grid = figure.subplots(4, 6, sharex=True, sharey=True)
        for row in grid:
            for panel in row:
                image = panel.imshow(np.zeros((3, 3)))
            figure.colorbar(image, ax=row[:3])
        figure.draw_without_rendering()
        narrow(figure)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # panels that find no room
            figure.draw_without_rendering()
    columns = {round(panel.get_position().x0, 2) for panel in grid.ravel()}
    assert len(columns) == 3  # the panels that share a colour bar
    assert len(figure.axes) == 28


def test_labels_that_would_leave_the_figure_are_broken_into_lines():
    figure = drawn(1)
    panel = figure.axes[0]
    panel.set_yticks([0.0], ["a long name of a thing"])
    panel.set_xlabel("number of the pair, its growth rate [1/s], its frequency [rad/s]")
    narrow(figure)
    figure.draw_without_rendering()
    box = panel.xaxis.label.get_window_extent()
    assert "\n" in panel.get_xlabel()
    assert 0.0 <= box.x0 < box.x1 <= figure.bbox.width


def test_a_picture_is_shown_wide_and_narrow_with_its_numbers():
    picture = Picture("speed", "How fast?", "Faster is better. So.", drawn(), pd.DataFrame())
    shown = show_both(picture, "data/speed.csv")
    assert 'viewBox="0 0 648 ' in shown.wide
    assert 'viewBox="0 0 295.2 ' in shown.narrow
    assert 'aria-label="Figure: How fast. Faster is better."' in shown.wide
    assert shown.numbers == "data/speed.csv"
