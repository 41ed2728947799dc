"""Diagnoses whose simulations diverge: healthy logs of another build, values that no unit has."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import Baseline, baseline_from
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.gain import held_out_gain
from deepkoco.diagnose.report.folder import write_report
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.data.windows import Windows, cut_windows, window_length
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.fit.threads import one_thread
from deepkoco.systems import make_system
from tests.fit.identify_logs import arm_log

# A build with a light forearm, whose friction is faster than the steps of the integration.
OTHER = {"mass_2": 0.05, "length_2": 0.25, "viscous_2": 5.0}


@pytest.fixture(scope="module", autouse=True)
def one_core():
    with one_thread():
        yield


@lru_cache
def windows() -> Windows:
    arm = make_system("two_link_arm")
    return cut_windows([arm_log(0)], arm, window_length(arm))


def of_another_build() -> Baseline:
    """What healthy logs of the other build say: its values, hardly uncertain."""
    own = baseline_from(make_system("two_link_arm"), windows())
    centre = np.array([OTHER.get(n, c) for n, c in zip(own.prior.names, own.prior.centre, strict=True)])
    prior = replace(own.prior, centre=centre, covariance=1e-4 * own.prior.covariance)
    return replace(own, values={**own.values, **OTHER}, prior=prior)


@pytest.fixture(scope="module")
def diagnosis():
    return diagnose(
        [arm_log(0)],
        "two_link_arm",
        baseline=of_another_build(),
        only=["coulomb(joint 2)"],
        detection=DETECTION,
    )


@pytest.mark.study
def test_baseline_of_another_build_is_left_out_and_reported(diagnosis, tmp_path):
    assert diagnosis.verdict != "insufficient"
    (told,) = diagnosis.unexplained["not_fitted"]
    assert "prior of the healthy logs" in told
    assert "diverges at" in told
    assert any(text.startswith("Could not be fitted: ") for text in diagnosis.advice)
    page = write_report(diagnosis, tmp_path / "report")
    assert "Could not be fitted: " in page.read_text()
    content = json.loads((tmp_path / "report" / "report.json").read_text())
    assert content["unexplained"]["not_fitted"] == [told]


@pytest.mark.study
def test_the_diagnosis_is_that_without_the_baseline(diagnosis):
    plain = diagnose([arm_log(0)], "two_link_arm", only=["coulomb(joint 2)"])
    assert diagnosis.verdict == plain.verdict
    assert diagnosis.names == plain.names
    assert diagnosis.chi2_after == pytest.approx(plain.chi2_after, rel=1e-9)
    assert plain.unexplained["not_fitted"] == []


def test_a_gain_is_not_told_of_windows_on_which_a_model_diverges():
    start = baseline_from(make_system("two_link_arm"), windows())
    held = windows().take(np.arange(2))
    models = {"baseline": {**start.values, **OTHER}, "refit": start.values, "extended": start.values}
    assert held_out_gain(start.system, held, models, 0) is None
    assert held_out_gain(start.system, held, {**models, "baseline": start.values}, 0) is not None


def test_missing_loads_stay_finite_where_a_load_makes_the_simulation_diverge():
    start = baseline_from(make_system("two_link_arm"), windows())
    few = windows().take(np.arange(2))
    problem = FitProblem(start.system, few)
    fit = problem.evaluate(start.values)
    # The fit of values at which nothing diverged, looked at where everything does.
    for found in missing_torque(problem, replace(fit, values={**fit.values, **OTHER})):
        assert np.isfinite(found.torque).all()
        assert np.isfinite(found.sd).all()
        assert np.isfinite(found.score).all()


def test_what_the_system_itself_cannot_simulate_is_refused_in_words():
    arm = make_system("two_link_arm")
    arm.parameters = tuple(replace(p, value=OTHER.get(p.name, p.value)) for p in arm.parameters)
    with pytest.raises(DivergedError, match="two_link_arm diverges at"):
        diagnose([arm_log(0)], arm, only=["coulomb(joint 2)"])
