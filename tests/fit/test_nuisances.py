"""Parameters that vary from log to log around a common mean (random effects)."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.fit.data.windows import cut_windows, window_length
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.fit.solve.prior import Prior
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

SYSTEM = make_system("rod_pendulum")
CHANGES = (0.0, 0.05, 0.03)
SPREAD = 0.03


@pytest.fixture(scope="module")
def windows():
    logs = [
        hidden_log("rod_pendulum", {"viscous": {"change": c}} if c else {}, drive, 9, 5.0)
        for c, drive in zip(CHANGES, ("chirp", "steps", "chirp"), strict=True)
    ]
    return cut_windows(logs, SYSTEM, window_length(SYSTEM))


def problem_of(windows, **varies):
    return FitProblem(baseline_from(SYSTEM, windows).system, replace(windows, varies=varies))


def fitted(problem):
    start = baseline_from(SYSTEM, problem.windows)
    prior = Prior(("viscous",), np.zeros(1), np.array([[0.02**2]]))
    return problem.fit([Trial("mean", ("viscous",), prior, start.values)], 60, 1e-9)[0]


def test_fit_with_varies_matches_dense_least_squares(windows):
    """SciPy minimises over the mean, the differences of the logs and all initial states together."""
    problem = problem_of(windows, viscous=SPREAD)
    fit = fitted(problem)
    column, logs = problem.names.index("viscous"), len(CHANGES)
    theta = np.array([[fit.values[n] for n in problem.names]])

    def residuals(x):
        at = theta.copy()
        at[0, column] = x[0]
        own, state = torch.from_numpy(x[None, 1 : 1 + logs]), torch.from_numpy(x[1 + logs :])
        predicted = problem.predict(at, state.view(1, len(windows), -1), own)[0]
        left = ((windows.value - predicted) * problem.weight).numpy().ravel()
        return np.concatenate([left, [x[0] / 0.02], x[1 : 1 + logs] / SPREAD])

    begin = np.concatenate([[0.0], np.zeros(logs), windows.state.numpy().ravel()])
    best = least_squares(residuals, begin, x_scale="jac", xtol=1e-14, ftol=1e-14)
    assert fit.cost == pytest.approx(2.0 * best.cost, rel=1e-6)
    assert fit.values["viscous"] == pytest.approx(best.x[0], abs=1e-5)
    np.testing.assert_allclose(fit.nuisance.numpy(), best.x[1 : 1 + logs], atol=1e-5)
    dense = np.linalg.inv(best.jac.T @ best.jac)
    assert fit.covariance[0, 0] == pytest.approx(dense[0, 0], rel=1e-3)
    assert fit.information[0, 0] == pytest.approx(1.0 / dense[0, 0] - 1.0 / 0.02**2, rel=1e-3)


def test_fit_with_wide_varies_equals_fits_of_single_logs(windows):
    problem = problem_of(windows, viscous=1.0)
    fit = fitted(problem)
    own = fit.values["viscous"] + fit.nuisance.numpy()
    for k in range(len(CHANGES)):
        alone = fitted(problem_of(windows.take(windows.log == k)))
        assert own[k] == pytest.approx(alone.values["viscous"], rel=0.02, abs=2e-4)
    np.testing.assert_allclose(own - own[0], CHANGES, atol=2e-3)
    assert fit.chi2 < 0.25 * fitted(problem_of(windows)).chi2


def test_fit_with_narrow_varies_equals_a_shared_parameter(windows):
    shared, tight = fitted(problem_of(windows)), fitted(problem_of(windows, viscous=1e-7))
    assert tight.values["viscous"] == pytest.approx(shared.values["viscous"], rel=1e-4)
    assert tight.cost == pytest.approx(shared.cost, rel=1e-5)


def test_known_in_predicts_the_same_as_fitted_differences(windows):
    problem = problem_of(windows, viscous=SPREAD)
    fit = fitted(problem)
    known = FitProblem(problem.system, problem.nuisances.known_in(problem.windows, fit.nuisance))
    assert known.windows.varies == {}
    theta = np.array([[fit.values[n] for n in problem.names]])
    held = known.predict(theta, fit.state[None], known.nuisances.none()[None])
    free = problem.predict(theta, fit.state[None], fit.nuisance[None])
    torch.testing.assert_close(held, free, rtol=0.0, atol=1e-12)


def test_predict_applies_a_varying_lag_to_its_log_only():
    """The lag of a motor acts on the command, not in the equations of motion."""
    system = make_system("quadrotor_height")
    logs = [hidden_log("quadrotor_height", {}, "steps", seed, 5.0) for seed in (1, 2)]
    windows = cut_windows(logs, system, 1.0)
    start = baseline_from(system, windows)
    problem = FitProblem(start.system, replace(windows, varies={"motor_lag": 0.01}))
    theta = np.array([[start.values[n] for n in problem.names]])
    slower = theta.copy()
    slower[0, problem.names.index("motor_lag")] += 0.02
    own = torch.tensor([[0.0, 0.02]], dtype=torch.float64)
    none, state = torch.zeros_like(own), windows.state[None]
    given = problem.predict(theta, state, own)[0]
    second = torch.from_numpy(windows.log == 1)
    as_all = problem.predict(slower, state, none)[0]
    torch.testing.assert_close(given[second], as_all[second])
    torch.testing.assert_close(given[~second], problem.predict(theta, state, none)[0][~second])
    assert not torch.allclose(given[second], problem.predict(theta, state, none)[0][second])


@pytest.mark.parametrize("free", [(), ("mass_1",), ("viscous_1", "mass_1", "viscous_2")])
def test_fit_minimises_over_zeros_and_differences_of_two_joints(free):
    """Two joints, two logs, encoder zeros, one known difference; checked by central differences of the cost."""
    system = make_system("two_link_arm")
    logs = [hidden_log("two_link_arm", {}, drive, 3, 4.0) for drive in ("chirp", "steps")]
    windows = cut_windows(logs, system, 1.0)
    start = baseline_from(system, windows)
    varies = {"viscous_1": 0.1, "mass_2": 0.02}
    windows = replace(windows, varies=varies, known=({}, {"viscous_1": 0.05}))
    problem = FitProblem(start.system, windows, zero_sd=0.02)
    declared = [problem.system.parameter(n) for n in free]
    fit = problem.fit([Trial("all", free, Prior.of(declared), start.values)], 60, 1e-9)[0]
    assert fit.nuisance.shape == (2 * 2 + 2 * 2,)
    theta = np.array([[fit.values[n] for n in problem.names]])

    def cost(nuisance):
        predicted = problem.predict(theta, fit.state[None], nuisance[None])[0]
        residual = (windows.value - predicted) * problem.weight
        return float((residual**2).sum()) + problem.nuisances.penalty(nuisance)

    for k, sd in enumerate(1.0 / problem.nuisances.precision.sqrt()):
        step = torch.zeros_like(fit.nuisance)
        step[k] = 1e-3 * sd
        down, up = cost(fit.nuisance - step), cost(fit.nuisance + step)
        curvature = (down + up - 2.0 * fit.chi2 - 2.0 * problem.nuisances.penalty(fit.nuisance)) / 1e-6
        # Decrease of the cost that a Newton step would give.
        assert ((up - down) / 2e-3) ** 2 / (2.0 * curvature) < 1e-2
    known, held = problem.as_fitted(fit)
    assert held.nuisance.shape == (2 * 2,)
    assert known.windows.known[1]["viscous_1"] == pytest.approx(0.05 + float(fit.nuisance[5]))
    torch.testing.assert_close(
        known.predict(theta, held.state[None], held.nuisance[None]),
        problem.predict(theta, fit.state[None], fit.nuisance[None]),
    )


def test_elsewhere_sets_fitted_differences_in_held_out_windows(windows):
    train, held = (
        windows.take(np.arange(len(windows)) % 2 == 0),
        windows.take(np.arange(len(windows)) % 2 == 1),
    )
    problem = problem_of(train, viscous=SPREAD)
    fit = fitted(problem)
    own = problem.elsewhere(held, fit)
    assert own.varies == {}
    assert [k["viscous"] for k in own.known] == pytest.approx(fit.nuisance.tolist())
    assert problem.values_in(fit, 1)["viscous"] == pytest.approx(
        fit.values["viscous"] + float(fit.nuisance[1])
    )
    # Windows with parameters that vary are returned unchanged.
    others = replace(held, varies={"viscous": SPREAD})
    assert problem.elsewhere(others, fit) is others
    told, not_told = (FitProblem(problem.system, w).evaluate(fit.values) for w in (own, held))
    assert told.chi2 < 0.5 * not_told.chi2
