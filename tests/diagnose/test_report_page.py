"""Report page of a diagnosis: both widths, remaining residuals, timing of a log."""

from dataclasses import replace
from datetime import date

import numpy as np
import pytest
import torch
from markupsafe import Markup

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.report.figures.all_figures import draw_all
from deepkoco.diagnose.report.figures.error_map import _by_slot
from deepkoco.diagnose.report.figures.layout import DESKTOP, PHONE, held_out_models, shown_models
from deepkoco.diagnose.report.figures.timing_figure import timing
from deepkoco.diagnose.report.page import render
from deepkoco.diagnose.report.parameter_table import parameter_rows
from deepkoco.diagnose.report.text import lead, spoken
from deepkoco.diagnose.report.unexplained_text import remains
from deepkoco.fit.data.windows import CommandSeries
from deepkoco.pages.figures import Shown
from experiments.studies.diagnosis.hidden.recorded import unit_log

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
    empty = Markup("")
    shown = [Shown(p.title, p.caption, empty, empty, f"{p.name}.csv") for p in draw_all(diagnosis)]
    return render(diagnosis, shown)


def test_page_has_every_picture_in_a_narrow_version(diagnosis):
    wide, narrow = draw_all(diagnosis, DESKTOP), draw_all(diagnosis, PHONE)
    assert [p.name for p in wide] == [p.name for p in narrow]
    assert {p.figure.get_figwidth() for p in wide} == {9.0}
    assert {p.figure.get_figwidth() for p in narrow} == {4.1}
    for a, b in zip(wide, narrow, strict=True):
        assert a.table.equals(b.table)


@pytest.mark.parametrize(
    ("panels", "wide"), [(1, (1, 1)), (2, (1, 2)), (3, (1, 3)), (4, (2, 2)), (5, (2, 3))]
)
def test_panels_get_rows_in_which_their_labels_have_room(panels, wide):
    assert DESKTOP.grid(panels) == wide
    assert PHONE.grid(panels) == (panels, 1)


def test_the_line_of_least_evidence_is_labelled_above_all_bars_and_grey_bars_beyond_it_are_explained(
    diagnosis,
):
    (picture,) = (p for p in draw_all(diagnosis) if p.name == "candidates")
    (axis,) = picture.figure.axes
    (label,) = (text for text in axis.texts if "least evidence" in text.get_text())
    assert label.get_position()[1] < min(bar.get_y() for bar in axis.patches)
    assert "Grey bars beyond the dashed line" in picture.caption


@pytest.mark.parametrize(("share", "told"), [(1.3, True), (0.7, False)])
def test_a_refit_that_is_worse_than_the_simulation_as_given_is_explained_where_it_shows(
    diagnosis, share, told
):
    gain = diagnosis.gain
    channel = replace(gain.channels[0], refit=share * gain.channels[0].baseline)
    changed = replace(diagnosis, gain=replace(gain, channels=(channel, *gain.channels[1:])))
    (picture,) = (p for p in draw_all(changed) if p.name == "error_by_horizon")
    assert ("The refit without the cause is worse here" in picture.caption) is told


def test_probabilities_are_drawn_and_told_for_every_named_cause(diagnosis):
    (cause,) = diagnosis.causes
    (picture,) = (p for p in draw_all(diagnosis) if p.name == "probabilities")
    assert picture.table["probability"].tolist() == list(cause.probabilities.values())
    assert picture.table["candidate"].tolist()[0] == spoken(cause.name)
    assert f"torque bias {cause.probability:.2f}, " in page_of(diagnosis)
    assert diagnosis.to_json()["causes"][0]["probabilities"] == cause.probabilities


def test_of_nothing_the_probability_is_told_too(diagnosis):
    chances = {"nothing": 0.9, "gain": 0.05, "unknown": 0.05}
    quiet = replace(diagnosis, verdict="nothing", causes=(), probabilities=chances)
    (picture,) = (p for p in draw_all(quiet) if p.name == "probabilities")
    assert picture.table["candidate"].tolist() == ["nothing", "gain", "something else"]
    assert quiet.to_json()["probabilities"] == chances


def test_found_parameters_show_null_and_interval(diagnosis):
    (found,) = (p for p in draw_all(diagnosis) if p.name == "found_parameters")
    (row,) = found.table.to_dict("records")
    assert row["parameter"] == "torque_bias.effort"
    assert row["null"] == 0.0
    assert row["low"] < 0.3 < row["high"]
    assert row["unit"] == "N m"


def test_the_page_explains_its_words_and_links_the_numbers_of_every_picture(diagnosis):
    page = page_of(diagnosis)
    for picture in draw_all(diagnosis):
        assert f'<a href="{picture.name}.csv">' in page
    assert "<dt>95 % interval</dt>" in page
    assert "prefers-color-scheme: dark" in page
    assert "What remains unexplained" not in page


def test_parameters_of_the_model_stand_beside_those_given_and_the_refit_is_a_detail(diagnosis):
    page = page_of(diagnosis)
    written = {p.name: p.value for p in diagnosis.model.parameters}
    assert set(diagnosis.final) == set(diagnosis.refit)
    for row, (name, final) in zip(parameter_rows(diagnosis), diagnosis.final.items(), strict=True):
        assert final.value == pytest.approx(written[name])
        assert final.low <= final.value <= final.high
        # The cells of a row: as given, then as model.yaml has it; what the refit says comes after "without".
        main, _, detail = page.partition("The refit without the named cause")
        cells = f'<td class="n">{row.given}</td><td class="n">{row.final}</td>'
        assert f"{row.name}</td>{cells}" in main
        assert f'<td class="i">{row.refit}</td>' in detail
    (picture,) = (p for p in draw_all(diagnosis) if p.name == "parameters")
    assert picture.table["value"].tolist() == [e.value for e in diagnosis.final.values()]
    assert picture.table["refit"].tolist() == [e.value for e in diagnosis.refit.values()]


def test_nothing_says_how_far_the_refit_moved_a_parameter_in_units_of_its_prior(diagnosis):
    name, estimate = next(iter(diagnosis.final.items()))
    mean, sd = diagnosis.details.priors[name]
    final = {n: replace(e, value=diagnosis.details.priors[n][0]) for n, e in diagnosis.final.items()}
    final[name] = replace(estimate, value=mean - 1.24 * sd)
    quiet = replace(diagnosis, verdict="nothing", causes=(), final=final)
    assert f"moved {spoken(name)} farthest" in lead(quiet)
    assert "1.2 standard deviations" in lead(quiet)
    assert quiet.to_json()["fit"]["prior_sds"][name] == pytest.approx(-1.24)


def test_the_page_says_what_to_type_next_and_when_and_by_what_it_was_made(diagnosis):
    page = render(diagnosis, [], "reports/monday", made=date(2026, 3, 4))
    assert '<a href="model.yaml">' in page
    assert "+task.kwargs.model=reports/monday/model.yaml" in page
    assert "--system reports/monday/model.yaml" in page
    assert "Made on 2026-03-04 with deepkoco " in page


def test_remains_describes_residuals_where_no_cause_is_named(unknown):
    said = " ".join(remains(unknown))
    assert f"at {unknown.unexplained['worst']['time_s']:.2f} s" in said
    assert " N m are missing there on joint 1" in said
    assert "What remains unexplained" in page_of(unknown)


def test_learned_load_replaces_the_extended_model_where_it_is_accepted(unknown):
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


def test_error_map_averages_errors_by_slot(diagnosis):
    details = diagnosis.details
    windows = details.windows
    residual = torch.zeros_like(details.refit.residual)
    # Two noise standard deviations in the second half of the first window, nothing elsewhere.
    late = (windows.t[0, 0] / windows.length * 20).to(int) >= 10
    residual[0, 0, late] = 2.0
    found = _by_slot(replace(details.refit, residual=residual), windows, 0, 20)
    np.testing.assert_allclose(found[0, 10:], 2.0 * windows.noise[0].sd)
    np.testing.assert_allclose(found[0, :10], 0.0, atol=1e-12)
    np.testing.assert_allclose(found[1:], 0.0, atol=1e-12)


def test_timing_figure_is_drawn_for_scattered_stamps_with_a_complete_mixture(diagnosis):
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
