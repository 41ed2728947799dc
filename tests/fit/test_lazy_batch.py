"""Fits that keep slopes from step to step, against fits that compute them at every step."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Trial
from deepkoco.fit.request import make_request
from deepkoco.fit.solve.lazy_batch import LazyBatch
from deepkoco.fit.solve.levenberg_marquardt import Batch
from deepkoco.fit.solve.prior import Prior
from tests.fit.identify_logs import TRUE, arm_log, rod_log

TOLERANCE = 1e-4


@pytest.fixture
def simulated(monkeypatch):
    """Numbers of windows that each call simulates."""
    counts, usual = [], FitProblem.predict

    def predict(self, theta, *rest):
        counts.append(len(theta) * len(self.windows))
        return usual(self, theta, *rest)

    monkeypatch.setattr(FitProblem, "predict", predict)
    return counts


@pytest.fixture
def arm():
    request = make_request([arm_log(0)], "two_link_arm", list(TRUE))
    return request.problem()


@pytest.fixture
def trial(arm):
    declared = {p.name: p for p in arm.system.parameters}
    values = {n: declared[n].value if n in declared else 0.0 for n in arm.names}
    state, _ = arm.fit_states(values, arm.windows.state)
    return Trial("refit", tuple(TRUE), Prior.of([declared[n] for n in TRUE]), values, state)


def test_kept_slopes_lead_to_the_same_fit_with_fewer_simulations(arm, trial, simulated):
    usual = Batch(arm, [trial], TOLERANCE).run(25)[0]
    many = sum(simulated)
    simulated.clear()
    kept = LazyBatch(arm, [trial], TOLERANCE).run(25)[0]
    assert kept.converged
    assert kept.exact
    assert abs(kept.cost - usual.cost) < 10.0 * TOLERANCE
    sd = np.sqrt(np.diag(usual.covariance))
    for name, own in zip(trial.free, sd, strict=True):
        assert abs(kept.values[name] - usual.values[name]) < 0.05 * own
    np.testing.assert_allclose(np.sqrt(np.diag(kept.covariance)), sd, rtol=0.02)
    assert sum(simulated) < many


def test_known_slopes_are_not_computed_again(arm, trial, simulated):
    reference = LazyBatch(arm, [trial], TOLERANCE).run(25)[0]
    names = trial.free[1:]
    known = arm.slopes_at(reference.values, names, reference.state, reference.nuisance)
    values = {**reference.values, trial.free[0]: 1.02 * reference.values[trial.free[0]]}
    simulated.clear()
    start = Trial(trial.name, trial.free, trial.prior, values, reference.state, reference.nuisance)
    found = LazyBatch(arm, [start], TOLERANCE, known, exact=False, renewals=0).run(5)[0]
    assert sum(simulated) <= 2 * 13 * len(
        arm.windows
    )  # each point, and the slope of the parameter that is not known
    assert not found.exact
    assert abs(found.cost - reference.cost) < 0.05


def test_equations_of_kept_slopes_are_those_of_new_ones(arm, trial):
    known = arm.slopes_at(trial.values, trial.free, trial.state, arm.nuisances.none())
    usual = Batch(arm, [trial])
    usual.run(1)
    kept = LazyBatch(arm, [trial], known=known, exact=False, renewals=0)
    kept.run(1)
    found, wanted = kept.normal[0], usual.normal[0]
    assert found is not None
    assert wanted is not None
    for name in ("hpp", "hps", "hss", "gp", "gs"):
        torch.testing.assert_close(getattr(found, name), getattr(wanted, name), rtol=1e-9, atol=1e-6)
    assert found.cost == pytest.approx(wanted.cost, rel=1e-12)


def test_a_fit_that_diverges_at_its_start_ends_without_slopes():
    problem = make_request([rod_log(4.0, 0)], "rod_pendulum", ["mass"]).problem()
    declared = {p.name: p.value for p in problem.system.parameters}
    values = {n: declared.get(n, 0.0) for n in problem.names}
    state = problem.windows.state * np.nan
    prior = Prior.of([problem.system.parameter("mass")])
    found = LazyBatch(problem, [Trial("lost", ("mass",), prior, values, state)]).run(5)[0]
    assert found.diverged
    assert found.values == values


class Valley:
    """One window that shows y - x^2 with little noise, and its initial state: Rosenbrock's valley.

    The prior alone says where in the valley x is, as it tells a load on a link from a heavier link.
    """

    names, low, high = ("x", "y"), np.full(2, -10.0), np.full(2, 10.0)
    scale = np.ones(2)
    weight = torch.ones(1, 3, 1, dtype=torch.float64)
    nuisances = SimpleNamespace(
        varies=(),
        spread=np.zeros(0),
        precision=torch.zeros(0, dtype=torch.float64),
        none=lambda: torch.zeros(0, dtype=torch.float64),
    )
    windows = SimpleNamespace(
        value=torch.zeros(1, 3, 1, dtype=torch.float64),
        state=torch.zeros(1, 2, dtype=torch.float64),
        samples=3,
    )

    def weighed(self, difference):
        return self.weight * difference

    def whitened(self, residual):
        return residual

    @property
    def with_usual_steps(self):
        return self

    def of_windows(self, index):
        return self

    def nuisance_slopes(self, slopes):
        return slopes[:0]

    def predict(self, theta, state, nuisance):
        x, y = torch.from_numpy(theta).T
        return torch.stack([1e2 * (y - x**2), state[:, 0, 0], state[:, 0, 1]], 1)[:, None, :, None]


def test_a_fit_follows_a_curved_valley_to_its_end():
    names = ("x", "y")
    prior = Prior(names, np.array([2.0, 0.0]), np.diag([0.1, 100.0]) ** 2)
    start = Trial("valley", names, prior, {"x": -1.0, "y": 1.0}, Valley.windows.state)
    found = LazyBatch(Valley(), [start]).run(25)[0]
    assert found.converged
    # y = x^2 costs (y / 100)^2 at most: the prior of x decides.
    assert found.values["x"] == pytest.approx(2.0, abs=0.01)
    assert found.values["y"] == pytest.approx(4.0, abs=0.05)


def test_a_fit_ends_where_no_step_promises_more_with_or_without_damping():
    """A straight valley so narrow that damping stops every step along it, beside something that nothing explains."""

    class Narrow(Valley):
        weight = torch.ones(1, 4, 1, dtype=torch.float64)
        windows = SimpleNamespace(
            value=torch.tensor([0.0, 0.0, 0.0, 10.0], dtype=torch.float64)[None, :, None],
            state=Valley.windows.state,
            samples=100,
        )

        def predict(self, theta, state, nuisance):
            x, y = torch.from_numpy(theta).T
            shown = torch.stack([3e3 * (y - x), state[:, 0, 0], state[:, 0, 1], 0.0 * x], 1)
            return shown[:, None, :, None]

    names = ("x", "y")
    prior = Prior(names, np.array([2.0, 0.0]), np.diag([1.0, 1e4]) ** 2)
    start = Trial("valley", names, prior, {"x": 1.2, "y": 1.2}, Valley.windows.state)
    found = LazyBatch(Narrow(), [start]).run(40)[0]
    assert found.converged
    assert found.cost - 100.0 < 0.05
    assert found.values["x"] == pytest.approx(2.0, abs=0.3)


def test_a_simulation_that_runs_away_beside_a_step_leaves_the_step_straight(arm, trial, monkeypatch):
    reference = LazyBatch(arm, [trial], TOLERANCE).run(25)[0]
    predict, probes = FitProblem.predict, []

    def running_away(self, theta, *rest):
        shown = predict(self, theta, *rest)
        if len(theta) == 2 and len(self.windows) == len(
            arm.windows
        ):  # both sides of a point: finite, but their products are not
            probes.append(True)
            return torch.full_like(shown, 1e302)
        return shown

    monkeypatch.setattr(FitProblem, "predict", running_away)
    batch = LazyBatch(arm, [trial], TOLERANCE)
    batch.curved[0] = True
    found = batch.run(25)[0]
    assert probes
    assert found.converged
    assert abs(found.cost - reference.cost) < 10.0 * TOLERANCE


def test_a_damping_that_another_fit_hands_on_ends_no_fit_early(arm, trial):
    """Steps with much damping promise little; that is no minimum before less damping was found to be too little."""
    usual = LazyBatch(arm, [trial], TOLERANCE).run(25)[0]
    much = LazyBatch(arm, [replace(trial, damping=1e3)], TOLERANCE).run(40)[0]
    assert much.converged
    assert abs(much.cost - usual.cost) < 10.0 * TOLERANCE


def test_a_damping_that_was_too_little_is_not_tried_again_after_the_next_step(arm, trial, monkeypatch):
    """A cost that allows short steps only: with less damping than 0.01, every step raises it."""
    tried = []
    usual = LazyBatch._judge

    def judge(self, k, normal, points):
        if self.normal[k] is not None and not self.renewing[k] and self.damping[k] < 0.01:
            normal = replace(normal, cost=self.cost[k] + 100.0)
        tried.append(float(self.damping[k]))
        usual(self, k, normal, points)

    monkeypatch.setattr(LazyBatch, "_judge", judge)
    fit = LazyBatch(arm, [trial], TOLERANCE).run(25)[0]
    assert fit.damping >= 0.01
    # Such a step is followed by one with the same damping, and a fit that begins there has it from the start.
    enough = [k for k, damping in enumerate(tried) if damping >= 0.01]
    assert tried[enough[0] + 1] >= 0.01
    tried.clear()
    LazyBatch(arm, [trial.from_fit(fit)], TOLERANCE).run(25)
    assert tried[0] == fit.damping


def test_a_fit_of_many_parameters_ends_where_each_is_near_its_minimum(arm, trial):
    many = LazyBatch(arm, [trial], 0.02)
    fine, found = LazyBatch(arm, [trial], 1e-6).run(60)[0], many.run(60)[0]
    assert found.converged
    assert len(found.history) <= len(fine.history)
    assert found.cost - fine.cost < 0.02 * len(trial.free) * max(1.0, found.chi2 / arm.windows.samples)
    sd = np.sqrt(np.diag(fine.covariance))
    off = [(found.values[n] - fine.values[n]) / s for n, s in zip(fine.free, sd, strict=True)]
    assert np.sqrt(np.mean(np.square(off))) < 0.3


@pytest.mark.parametrize(("asked", "each"), [(0.02, 0.02), (1e-4, 1e-4), (0.2, 0.02)])
def test_the_tolerance_is_that_of_each_parameter_but_no_less_than_what_is_asked_for(arm, trial, asked, each):
    batch = LazyBatch(arm, [trial], asked)
    batch.cost[0] = 1.0
    assert batch._tolerance(0) == pytest.approx(max(asked, each * len(trial.free)))
