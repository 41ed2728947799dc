"""Fits under errors that are correlated in time."""

import numpy as np
import pytest
import torch

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.fit.coloured import ColouredProblem, whitening
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.fit.fit_types import Fit
from tests.oracle.slide import Car, Unit, log_of

POLES = (1.0, -1.6, 0.7)  # of a slow, damped error: e_k = r_k - 1.6 r_(k-1) + 0.7 r_(k-2)


def problem_of(unit: Unit, seed: int) -> FitProblem:
    windows = cut_windows([log_of(unit, seed, 18.0)], Car(), 1.5)
    return FitProblem(baseline_from(Car(), windows).system, windows)


def fit_of(problem: FitProblem, free: tuple[str, ...] = ("mass", "viscous", "coulomb.torque")) -> Fit:
    start = baseline_from(Car(), problem.windows)
    own = [p for p in start.system.parameters if p.name in free and "." in p.name]
    prior = start.prior.widened(own, {p.name: 0.0 for p in own})
    values = {**start.values, "coulomb.torque": 15.0}
    state, _ = problem.fit_states(values, problem.windows.state)
    return problem.fit([Trial("fit", prior.names, prior, values, state)], 30)[0]


@pytest.fixture(scope="module")
def problem():
    return problem_of(Unit(110.0, 180.0, 15.0), 20_100)


def with_residual(fit: Fit, residual: np.ndarray) -> Fit:
    fit.residual = torch.from_numpy(residual)
    return fit


def test_whitening_finds_the_filter_of_an_autoregressive_error(problem):
    rng = np.random.default_rng(20_101)
    shape = tuple(problem.windows.value.shape)
    drawn = rng.normal(size=(*shape[:2], shape[2] + 500))
    error = np.zeros_like(drawn)
    for k in range(2, drawn.shape[-1]):
        error[..., k] = drawn[..., k] - POLES[1] * error[..., k - 1] - POLES[2] * error[..., k - 2]
    fit = problem.fit(
        [
            Trial(
                "null",
                (),
                baseline_from(Car(), problem.windows).prior,
                baseline_from(Car(), problem.windows).values,
            )
        ],
        1,
    )[0]
    found = whitening(problem, [with_residual(fit, error[..., 500:])])
    sd = problem.windows.noise[0].sd
    assert found[0].coefficients[:3] == pytest.approx(POLES, abs=0.06)
    assert found[0].sd == pytest.approx(sd, rel=0.05)


def test_coloured_problem_filters_measurements_and_simulations_alike(problem):
    fit = fit_of(problem)
    coloured = ColouredProblem(problem, whitening(problem, [fit]))
    theta = np.array([[fit.values[n] for n in problem.names]])
    plain = problem.predict(theta, fit.state[None], fit.nuisance[None])[0]
    shown = coloured.predict(theta, fit.state[None], fit.nuisance[None])[0]
    a = coloured.filters[0].coefficients
    order = len(a) - 1
    assert order >= 1
    row = plain[2, 0].numpy()
    wanted = np.convolve(row, a)[: len(row)]
    assert shown[2, 0].numpy()[order:] == pytest.approx(wanted[order:], abs=1e-12)
    # The first samples have no known past.
    assert not bool(coloured.weight[..., :order].any())
    assert bool((coloured.weight[..., order:] > 0.0).any())


@pytest.mark.study
def test_of_two_forces_with_one_mean_correlated_errors_tell_which_was_there():
    # A force along the rail that no model has leaves slow errors, in which offset and asymmetry look alike. Dry
    # friction can leave many minima; these two logs have one, whatever values a fit starts from.
    for seed, hidden, other in (
        (20_114, "torque_bias.effort", "asymmetry.share"),
        (20_111, "asymmetry.share", "torque_bias.effort"),
    ):
        size = {"offset": 3.0} if hidden.startswith("torque_bias") else {"asymmetry": 0.07}
        problem = problem_of(Unit(100.0, 200.0, 18.0, ripple=6.0, **size), seed)
        free = ("mass", "viscous", "coulomb.torque")
        fits = [fit_of(problem, (*free, name)) for name in (hidden, other)]
        coloured = ColouredProblem(problem, whitening(problem, fits))
        start = baseline_from(Car(), problem.windows)
        again = []
        for fit in fits:
            own = [p for p in start.system.parameters if p.name in fit.free and "." in p.name]
            prior = start.prior.widened(own, {p.name: 0.0 for p in own})
            again.append(coloured.fit([Trial("again", prior.names, prior, fit.values, fit.state)], 25)[0])
        assert all(fit.converged for fit in again)
        assert again[0].cost + 6.0 < again[1].cost
