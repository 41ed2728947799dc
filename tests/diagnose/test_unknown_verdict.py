"""Verdict `unknown` for imitations of a cause, and pushes in held-out windows."""

import numpy as np
import pytest
import torch

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.causes import CAUSES
from deepkoco.diagnose.report.text import lead
from deepkoco.diagnose.report.unexplained_text import remains
from deepkoco.diagnose.verdict.unknown import carries_over
from deepkoco.fit.fit import Fit
from tests.oracle.unit import hidden_log


def fit_with(chi2_by_window):
    """A fit whose windows leave these chi2."""
    residual = torch.sqrt(torch.tensor(chi2_by_window, dtype=torch.float64))[:, None, None]
    nothing = np.zeros((0, 0))
    chi2 = float(sum(chi2_by_window))
    return Fit(
        "", (), {}, nothing, nothing, torch.zeros(0), torch.zeros(0), chi2, 0.0, residual, nothing, [], True
    )


def test_carries_over_is_false_for_a_cause_that_improves_fitted_windows_only():
    before, after = fit_with([200.0] * 12), fit_with([100.0, 110.0, 90.0] * 4)
    assert not carries_over(before, after, fit_with([200.0] * 4), fit_with([201.0, 198.0, 205.0, 200.0]))
    assert carries_over(before, after, fit_with([200.0] * 4), fit_with([120.0, 95.0, 110.0, 100.0]))


def test_carries_over_is_true_for_a_cause_in_few_windows():
    before, after = fit_with([200.0] * 12), fit_with([200.0] * 10 + [20.0, 30.0])
    assert carries_over(before, after, fit_with([200.0] * 4), fit_with([200.0] * 4))


@pytest.mark.study
@pytest.mark.parametrize(
    ("hidden", "imitators", "seed"),
    [
        ({"position_friction": {"size": 0.24}}, ["quadratic"], 129),
        ({"gain_curve": {"curvature": -0.0175}}, ["saturation"], 153),
    ],
)
def test_diagnose_returns_unknown_for_imitations_of_a_cause(hidden, imitators, seed):
    log = hidden_log("rod_pendulum", hidden, "closed-loop", seed)
    result = diagnose([log], "rod_pendulum", only=imitators)
    assert result.chi2_before > 1.2
    assert result.candidates[0].delta_bic > 100.0
    assert result.verdict == "unknown"
    # What was rejected is neither in the model nor in what is said of the rest.
    assert not {e.name for e in result.model.effects} & set(imitators)
    assert result.unexplained["chi2_per_sample"] == pytest.approx(result.chi2_before)


@pytest.mark.study
@pytest.mark.parametrize("start", [6.1, 7.4, 8.7])
def test_diagnose_finds_a_push_in_every_window(start):
    push = {"event": {"torque": 0.2, "start": start, "duration": 0.2}}
    only = ["event", "lag", "cogging"]
    result = diagnose([hidden_log("rod_pendulum", push, "steps", 133, 15.0)], "rod_pendulum", only=only)
    assert result.names == ("event",)
    found = result.causes[0].parameters
    middle = found["event.start"].value + 0.5 * found["event.duration"].value
    assert middle == pytest.approx(start + 0.1, abs=0.03)
    impulse = found["event.torque"].value * found["event.duration"].value
    assert impulse == pytest.approx(0.04, rel=0.1)


@pytest.mark.study
def test_push_does_not_improve_other_windows_and_remaining_structure_is_reported():
    hidden = {
        "event": {"torque": 1.5, "start": 6.1, "duration": 0.2},
        "turbulence": {"size": 0.03},
    }
    result = diagnose(
        [hidden_log("rod_pendulum", hidden, "steps", 133, 15.0)], "rod_pendulum", only=["event"]
    )
    assert result.names == ("event",)
    # The refit with which it is compared does not bend to the push.
    assert abs(result.gain.reduction) < 0.05
    assert result.chi2_after > 1.3 * result.unexplained["limits"]["chi2_per_sample"]
    assert "The named causes do not explain everything" in lead(result)
    assert remains(result)[0] in lead(result)


def test_stretched_pushes_keep_impulse_and_middle():
    values = {"event.torque": 0.3, "event.start": 5.0, "event.duration": 0.2}
    valley = CAUSES["event"].valley
    assert valley is not None
    for other in valley(values):
        assert other["event.torque"] * other["event.duration"] == pytest.approx(0.06)
        assert other["event.start"] + 0.5 * other["event.duration"] == pytest.approx(5.1)
