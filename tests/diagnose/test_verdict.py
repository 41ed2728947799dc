"""Verdict on selected causes."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from deepkoco.diagnose.baseline import Healthy, baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.verdict.verdict import rivalled, verdict_of, without_explanation
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

BASE = make_system("rod_pendulum")
KNOWN = catalogue(BASE)


@pytest.fixture(scope="module")
def stage():
    """Windows, their baseline, and fits with a given chi2 that is the same in every sample."""
    windows = cut_data([hidden_log("rod_pendulum", {}, "steps", 172, 12.0)], (), BASE, 1.6).train
    start = baseline_from(BASE, windows)
    fit = FitProblem(start.system, windows).evaluate(start.values)

    def leaving(chi2):
        residual = windows.valid * chi2**0.5
        return replace(fit, residual=residual, chi2=float((residual**2).sum()))

    return windows, start, leaving


def verdict(stage, names, after, **given):
    return ruling(stage, names, after, **given).verdict


def ruling(
    stage, names, after, *, before=10.0, kept=(10.0, 2.0), white=True, doubts=(), lost=None, healthy=False
):
    windows, start, leaving = stage
    causes = tuple(KNOWN[n] for n in names)
    found = Selected(leaving(after), causes, tuple((None, (n,)) for n in names), None, lost)
    if healthy:
        start = replace(start, healthy=Healthy((), windows, start, (), leaving(1.0)))
    gain = None
    if kept is not None:
        refit, extended = (leaving(chi2) for chi2 in kept)
        fits = {"refit": refit, "extended": extended}
        worth = 1.0 - (kept[1] / kept[0]) ** 0.5
        gain = SimpleNamespace(fits=fits, reduction=worth, replayed=windows)
    return verdict_of(found, start, windows, leaving(before), gain, white, doubts)


def test_verdict_without_causes_depends_on_remaining_structure(stage):
    assert verdict(stage, (), 1.0, before=1.0) == "nothing"
    assert verdict(stage, (), 2.0, before=2.0) == "unknown"


def test_verdict_names_causes_that_leave_noise_unless_there_are_doubts(stage):
    assert verdict(stage, ["coulomb"], 1.0) == "cause"
    assert verdict(stage, ["coulomb"], 1.0, doubts=["its unit is odd"]) == "unknown"


@pytest.mark.parametrize(
    ("names", "after", "healthy", "expected"),
    [
        (["coulomb"], 3.0, False, "cause"),  # 78 % of the excess: real logs keep some model error
        (["coulomb"], 5.5, False, "unknown"),  # half of it
        (["coulomb"], 3.0, True, "unknown"),  # how much model error there is, healthy logs tell
        (["coulomb"], 1.5, True, "cause"),  # 94 %: units vary from log to log
        (["coulomb"], 1.05, True, "cause"),
        (["event"], 3.0, False, "unknown"),  # a push leaves other windows as they are
        (["event"], 1.5, False, "cause"),
        (
            ["periodic"],
            3.0,
            False,
            "unknown",
        ),  # a tone describes most of a resonance that the simulation lacks
        (["periodic"], 1.5, False, "cause"),
        (["coulomb", "periodic"], 3.0, False, "cause"),
        (["coulomb", "viscous", "gain"], 3.0, False, "unknown"),  # the search ended at its limit
        (["coulomb", "viscous", "gain"], 1.0, False, "cause"),
    ],
)
def test_verdict_with_remaining_structure_needs_the_explained_share(stage, names, after, healthy, expected):
    assert verdict(stage, names, after, healthy=healthy, white=after < 2.0) == expected


@pytest.mark.parametrize(
    ("after", "held_out", "expected"), [(1.0, 10.0, "unknown"), (1.5, 10.0, "unknown"), (1.0, 1.0, "cause")]
)
def test_a_push_is_no_cause_of_what_windows_that_it_does_not_touch_show(stage, after, held_out, expected):
    assert verdict(stage, ["event"], after, kept=(10.0, held_out)) == expected


@pytest.mark.parametrize(
    ("names", "after", "white", "compared"),
    [
        (["coulomb"], 3.0, False, False),  # every simulation of a real log leaves something
        (["coulomb", "periodic"], 3.0, False, True),  # the tone may stand for what is missing
        (["coulomb", "cogging"], 3.0, True, False),
        (["coulomb", "periodic"], 1.0, True, False),
        (["periodic"], 1.0, True, True),
    ],
)
def test_tones_and_detents_that_leave_structure_are_compared_with_a_learned_load(
    stage, names, after, white, compared
):
    windows, start, leaving = stage
    found = Selected(leaving(after), tuple(KNOWN[n] for n in names), (), None, None)
    assert rivalled(found, start, windows, white) is compared


@pytest.mark.parametrize(
    ("roughness", "penalty", "expected"),
    [
        (
            10.0,
            3000.0,
            "cause",
        ),  # the refit left the spread of units of one make, and the cause brings it back
        (10.0, 0.0, "unknown"),
        (1.0, 3000.0, "unknown"),  # a declared prior does not count as samples do
    ],
)
def test_a_refit_that_strays_from_units_of_one_make_leaves_a_misfit(stage, roughness, penalty, expected):
    windows, start, leaving = stage
    found = Selected(leaving(1.3), (KNOWN["viscous"],), ((None, ("viscous",)),), None)
    before = replace(leaving(1.301), penalty=penalty)
    held = {"refit": leaving(1.3), "extended": leaving(1.3)}
    gain = SimpleNamespace(fits=held, reduction=0.0)
    start = replace(start, roughness=roughness)
    assert verdict_of(found, start, windows, before, gain, False, ()).verdict == expected


@pytest.mark.parametrize(("held_out", "expected"), [(1.0, "cause"), (0.9, "cause"), (1.2, "unknown")])
def test_what_a_cause_gains_by_a_prior_is_less_what_held_out_windows_lose(stage, held_out, expected):
    windows, start, flat = stage
    sign = 1.0 - 2.0 * torch.randint(2, windows.valid.shape, generator=torch.Generator().manual_seed(0))

    def leaving(chi2):
        fit = flat(chi2)
        return replace(fit, residual=fit.residual * sign)

    found = Selected(leaving(1.0), (KNOWN["viscous"],), ((None, ("viscous",)),), None)
    before = replace(leaving(1.0), penalty=45.0)
    gain = SimpleNamespace(fits={"refit": leaving(1.0), "extended": leaving(held_out)}, reduction=0.0)
    assert verdict_of(found, start, windows, before, gain, True, ()).verdict == expected


def test_a_learned_load_competes_again_only_with_causes_that_have_not_outweighed_it(stage):
    windows, start, leaving = stage
    found = Selected(leaving(1.05), (KNOWN["coulomb"],), (), None)
    assert rivalled(found, start, windows, False)
    assert not rivalled(found, start, windows, False, weighed=True)


def test_verdict_needs_the_carry_over_to_held_out_windows(stage):
    assert verdict(stage, ["coulomb"], 1.0, kept=(10.0, 1.0)) == "cause"
    assert verdict(stage, ["coulomb"], 1.0, kept=(10.0, 10.0)) == "unknown"
    assert verdict(stage, ["coulomb"], 1.0, kept=None) == "cause"


def test_verdict_without_held_out_windows_needs_nearly_the_whole_share(stage):
    assert verdict(stage, ["gain"], 3.0, kept=None) == "unknown"
    assert verdict(stage, ["gain"], 30.0, before=1000.0, kept=None) == "unknown"
    assert verdict(stage, ["gain"], 10.0, before=1000.0, kept=None) == "cause"


def test_verdict_is_unknown_for_three_flexible_causes(stage):
    assert verdict(stage, ["cogging"], 1.0) == "cause"
    assert verdict(stage, ["cogging", "periodic", "event"], 1.0) == "unknown"
    assert verdict(stage, ["coulomb", "periodic", "event"], 1.0) == "cause"


def test_verdict_is_unknown_for_lost_commands_with_structure_or_pushes(stage):
    assert verdict(stage, [], 1.0, lost=SimpleNamespace(name="lost_commands")) == "cause"
    assert verdict(stage, [], 2.0, lost=SimpleNamespace(name="lost_commands")) == "unknown"
    assert verdict(stage, ["event"], 1.0, lost=SimpleNamespace(name="lost_commands")) == "unknown"
    assert verdict(stage, ["coulomb"], 1.0, lost=SimpleNamespace(name="lost_commands")) == "cause"


def refit_with(stage, chi2, white):
    """A refit whose residuals have this size, independent from sample to sample or constant."""
    windows, _, leaving = stage
    fit = leaving(chi2)
    if white:
        drawn = torch.randn(
            fit.residual.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
        )
        residual = drawn * windows.valid
        residual *= (chi2 * windows.samples / residual.square().sum()).sqrt()
        fit = replace(fit, residual=residual, chi2=float(residual.square().sum()))
    return fit


@pytest.mark.parametrize(
    ("chi2", "white", "expected"),
    [(1.0, True, "nothing"), (2.0, True, "unknown"), (1.0, False, "unknown")],
)
def test_a_vetoed_explanation_leaves_the_verdict_to_the_refit(stage, chi2, white, expected):
    windows, start, _ = stage
    assert without_explanation(refit_with(stage, chi2, white), windows, start, BASE) == expected


def test_a_vetoed_explanation_of_a_log_with_a_wrong_unit_is_unknown(stage):
    windows, start, _ = stage
    tiny = tuple(replace(c, value=1e-7 * c.value) for c in windows.commands)
    wrong = replace(windows, commands=tiny)
    assert without_explanation(refit_with(stage, 1.0, True), wrong, start, BASE) == "unknown"


@pytest.mark.parametrize(
    ("names", "after", "given", "words"),
    [
        (
            ["coulomb"],
            3.0,
            {"healthy": True},
            "coulomb (torque = 0), 77.8% of the difference is explained; 90% is asked",
        ),
        (
            ["periodic"],
            1.5,
            {"healthy": True},
            "94.4% of the difference is explained; 98% is asked",
        ),
        (["coulomb"], 5.5, {}, "coulomb (torque = 0), 50.0% of the difference is explained; 60% is asked"),
        (["coulomb"], 3.0, {"kept": (10.0, 9.0), "white": False}, "the held-out error falls by 5%"),
        (
            ["coulomb"],
            1.0,
            {"kept": (10.0, 10.0)},
            "the fitted windows improve, but the held-out ones do not",
        ),
        (
            ["coulomb", "viscous", "gain"],
            3.0,
            {"white": False},
            "and gain (factor = 1); no more are searched for",
        ),
        (["event", "periodic", "cogging"], 1.0, {}, "So many pushes, tones or detents"),
    ],
)
def test_each_veto_of_selected_causes_says_why(stage, names, after, given, words):
    found = ruling(stage, names, after, **given)
    assert found.verdict == "unknown"
    assert words in found.why


def test_named_causes_and_doubts_need_no_further_reason(stage):
    assert ruling(stage, ["coulomb"], 1.0).why is None
    assert ruling(stage, ["coulomb"], 1.0, doubts=["its unit is odd"]).why is None
