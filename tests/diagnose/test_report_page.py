"""What the page of a diagnosis shows: both widths, what remains, the timing of a log."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.report.figures.all_figures import draw_all
from deepkoco.diagnose.report.figures.error_map import _by_slot
from deepkoco.diagnose.report.figures.layout import DESKTOP, PHONE, held_out_models, shown_models
from deepkoco.diagnose.report.figures.timing_figure import timing
from deepkoco.diagnose.report.page import render
from deepkoco.diagnose.report.unexplained_text import remains
from deepkoco.fit.data.windows import CommandSeries
from experiments.hidden.recorded import unit_log

LEARNED = {
    "accepted": True,
    "reason": "it lowers the error",
    "terms": [{"name": "learned.drag", "weight": 0.2, "sd": 0.01, "unit": "N m s"}],
    "reduction_vs_refit": 0.4,
}


@pytest.fixture(scope="module")
def diagnosis():
    log = unit_log("rod_pendulum", {"torque_bias": {"effort": 0.3}}, "steps", 5, 15.0)
    return diagnose([log], "rod_pendulum", only=["torque_bias", "coulomb", "gain"])


@pytest.fixture(scope="module")
def unknown(diagnosis):
    return replace(diagnosis, verdict="unknown", causes=())


def page_of(diagnosis):
    pictures = draw_all(diagnosis)
    empty = {picture.name: b"" for picture in pictures}
    return render(diagnosis, pictures, empty, empty)


def test_a_phone_gets_the_same_pictures_in_a_width_that_it_can_show(diagnosis):
    wide, narrow = draw_all(diagnosis, DESKTOP), draw_all(diagnosis, PHONE)
    assert [p.name for p in wide] == [p.name for p in narrow]
    assert {p.figure.get_figwidth() for p in wide} == {9.0}
    assert {p.figure.get_figwidth() for p in narrow} == {4.1}
    for a, b in zip(wide, narrow, strict=True):
        assert a.table.equals(b.table)


def test_the_bias_is_shown_with_its_null_and_its_interval(diagnosis):
    (found,) = (p for p in draw_all(diagnosis) if p.name == "found_parameters")
    (row,) = found.table.to_dict("records")
    assert row["parameter"] == "torque_bias.effort"
    assert row["null"] == 0.0
    assert row["low"] < 0.3 < row["high"]
    assert row["unit"] == "N m"


def test_the_page_explains_its_words_and_gives_every_picture_a_text(diagnosis):
    page = page_of(diagnosis)
    assert page.count("<img ") == page.count('<img alt="Figure: ') == len(draw_all(diagnosis))
    assert "<dt>95 % interval</dt>" in page
    assert "prefers-color-scheme: dark" in page
    assert "What remains unexplained" not in page


def test_what_remains_is_told_where_no_cause_is_named(unknown):
    said = " ".join(remains(unknown))
    assert f"at {unknown.unexplained['worst']['time_s']:.2f} s" in said
    assert " N m are missing there on joint 1" in said
    assert "What remains unexplained" in page_of(unknown)


def test_a_learned_load_stands_in_for_a_cause(unknown):
    learned = replace(unknown, unexplained={**unknown.unexplained, "residual_model": LEARNED})
    assert "extended" not in shown_models(learned)
    assert held_out_models(learned)["extended"] == "simulation with a learned load"
    assert "extended" not in held_out_models(unknown)
    said = remains(learned)[-1]
    assert "0.2 N m s for learned.drag" in said
    assert "lowers the held-out error by 40 %" in said
    refused = {**LEARNED, "accepted": False, "reason": "it does not"}
    refused_too = replace(unknown, unexplained={**unknown.unexplained, "residual_model": refused})
    assert remains(refused_too)[-1] == "No learned load was added to the simulation: it does not."
    assert "extended" not in held_out_models(refused_too)


def test_errors_are_gathered_by_the_piece_of_the_window_they_fall_into(diagnosis):
    details = diagnosis.details
    windows = details.windows
    residual = torch.zeros_like(details.refit.residual)
    # Two noise standard deviations in the second half of the first window, nothing elsewhere.
    late = windows.t[0, 0] > 0.5 * windows.length
    residual[0, 0, late] = 2.0
    found = _by_slot(replace(details.refit, residual=residual), windows, 0, 20)
    np.testing.assert_allclose(found[0, 10:], 2.0 * windows.noise[0].sd)
    np.testing.assert_allclose(found[0, :10], 0.0, atol=1e-12)
    np.testing.assert_allclose(found[1:], 0.0, atol=1e-12)


def test_timing_is_drawn_where_stamps_scatter_and_its_mixture_holds_all_of_them(diagnosis):
    details = diagnosis.details
    assert timing(diagnosis, details, DESKTOP) is None  # virtual time: every period alike
    rng = np.random.default_rng(3)
    # Every fourth command waits for 5 ms more.
    spacing = np.where(np.arange(800) % 4 == 0, 0.025, 0.02) + 2e-4 * rng.standard_normal(800)
    series = CommandSeries(np.cumsum(spacing), np.zeros(800))
    late = replace(details, windows=replace(details.windows, commands=(series,)))
    picture = timing(diagnosis, late, DESKTOP)
    assert picture is not None
    table = picture.table
    assert set(table["of"]) == {"commands"}
    assert table["count"].sum() == pytest.approx(0.99 * 799, rel=0.01)
    assert table["mixture"].sum() == pytest.approx(0.99 * 799, rel=0.02)
    slow = table[table["middle_ms"] > 22.5]
    assert slow["mixture"].sum() == pytest.approx(199, rel=0.1)
