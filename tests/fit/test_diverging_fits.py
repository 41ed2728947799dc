"""Fits of two joints with start values at which the simulation diverges or nearly diverges."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco.fit import FitError, fit
from deepkoco.fit.fit_types import Trial
from deepkoco.fit.request import make_request
from deepkoco.fit.solve.methods import LevenbergMarquardt
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.recording import LogError
from deepkoco.systems.bodies.rod_pendulum import RodPendulum
from tests.fit.identify_logs import TRUE, arm_log, rod_log

# With a light forearm, the time constant of the joint friction is shorter than the integration step.
LIGHT = {"mass_2": 0.05, "length_2": 0.25}


@pytest.fixture(scope="module")
def fit_request():
    return make_request([arm_log(0)], "two_link_arm", list(TRUE))


@pytest.fixture(scope="module")
def problem(fit_request):
    return fit_request.problem(fit_request.windows.take(np.arange(3)))


def chi2(fit_request, problem, viscous: float) -> float:
    values = fit_request.start | LIGHT | {"viscous_2": viscous}
    theta = np.array([[values[n] for n in problem.names]])
    predicted = problem.predict(theta, problem.windows.state[None], problem.nuisances.none()[None])
    return float((((problem.windows.value - predicted[0]) * problem.weight) ** 2).sum())


@pytest.fixture(scope="module")
def edge(fit_request, problem) -> float:
    """Friction [N m s/rad] between simulations that stay finite and those that diverge."""
    low, high = 0.05, 1.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.isfinite(chi2(fit_request, problem, middle)) else (low, middle)
    return low


def test_fit_near_the_edge_of_divergence_is_finite_or_diverged(fit_request, problem, edge):
    near = edge * (1.0 + np.concatenate([np.linspace(-0.03, 0.05, 25), [-1e-6, -1e-9, 1e-9]]))
    starts = [fit_request.start | LIGHT | {"viscous_2": float(v)} for v in near]
    fits = problem.fit([Trial("edge", fit_request.free, fit_request.prior, values) for values in starts], 6)
    assert any(found.diverged for found in fits)
    assert not all(found.diverged for found in fits)
    for found, values in zip(fits, starts, strict=True):
        assert np.isfinite(found.covariance).all()
        assert np.isfinite(found.curvature).all()
        assert np.isfinite(found.information).all()
        assert torch.isfinite(found.residual).all()
        assert torch.isfinite(found.state).all()
        if found.diverged:
            assert found.cost == np.inf
            assert found.values["viscous_2"] == values["viscous_2"]


def test_fit_of_a_diverging_trial_does_not_change_other_trials(fit_request, problem, edge):
    good = Trial("good", fit_request.free, fit_request.prior, fit_request.start)
    bad = replace(good, name="bad", values=fit_request.start | LIGHT | {"viscous_2": 1.1 * edge})
    alone, (beside, lost) = problem.fit([good], 6)[0], problem.fit([good, bad], 6)
    assert lost.diverged
    assert beside.values == pytest.approx(alone.values, rel=1e-9)


def test_fit_one_names_the_values_that_diverge(fit_request, problem, edge):
    values = fit_request.start | LIGHT | {"viscous_2": 1.1 * edge}
    with pytest.raises(DivergedError, match=r"two_link_arm diverges at .*mass_2 = 0.05 kg"):
        problem.fit_one(Trial("refit", fit_request.free, fit_request.prior, values))


def test_fit_states_stay_finite_if_a_window_diverges(fit_request, problem, edge):
    values = fit_request.start | LIGHT | {"viscous_2": edge * (1.0 - 1e-6)}
    states, _ = problem.fit_states(values, problem.windows.state)
    assert torch.isfinite(states).all()


def test_fit_refuses_diverging_start_values():
    with pytest.raises(FitError, match="diverges at the start values"):
        fit([arm_log(0)], "two_link_arm", ["viscous_1"], start=LIGHT | {"viscous_2": 5.0})


@pytest.mark.parametrize("channel", ["torque_1", "angle_2"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_fit_names_the_channel_of_samples_that_are_not_finite(channel, wrong):
    log = arm_log(0)
    values = log.channels[channel].value.copy()
    values[[3, 4]] = wrong
    broken = replace(log, channels={**log.channels, channel: replace(log.channels[channel], value=values)})
    with pytest.raises(LogError, match=f'"{channel}" has 2 of {len(values)} samples'):
        fit([broken], "two_link_arm", ["mass_2"])


class UnboundedMass(RodPendulum):
    """A rod whose mass has no upper bound."""

    def __init__(self) -> None:
        super().__init__()
        self.parameters = tuple(replace(p, high=np.inf) if p.name == "mass" else p for p in self.parameters)


def test_a_parameter_without_finite_bounds_needs_bounds_or_a_prior():
    log = rod_log(4.0, 0)
    with pytest.raises(FitError, match=r"mass: bounds 0.1 to inf kg: a fit needs finite ones"):
        fit([log], UnboundedMass(), ["mass"])
    found = fit([log], UnboundedMass(), ["mass"], prior=Prior(("mass",), np.ones(1), np.full((1, 1), 0.25)))
    assert found.estimates["mass"].value == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_prior_that_is_not_finite_is_refused(bad):
    with pytest.raises(FitError, match="prior: mass: its mean and its covariances must be finite"):
        fit(
            [rod_log(4.0, 0)],
            "rod_pendulum",
            ["mass"],
            prior=Prior(("mass",), np.ones(1), np.full((1, 1), bad)),
        )


class Overflowing(LevenbergMarquardt):
    """A method of a user's own, whose curvature overflows."""

    def solve(self, request, generator, progress):
        found = super().solve(request, generator, progress)
        return replace(found, fit=replace(found.fit, curvature=found.fit.curvature * np.inf))


def test_a_curvature_that_is_not_finite_is_a_fit_error():
    with pytest.raises(FitError, match=r"curvature of the fit is not finite .* mass get no intervals"):
        fit([rod_log(4.0, 0)], "rod_pendulum", ["mass"], method=Overflowing())
