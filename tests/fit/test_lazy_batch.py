"""Fits that keep slopes from step to step, against fits that compute them at every step."""

import numpy as np
import pytest
import torch

from deepkoco.fit.fit_types import Trial
from deepkoco.fit.request import make_request
from deepkoco.fit.solve.lazy_batch import LazyBatch
from deepkoco.fit.solve.levenberg_marquardt import Batch
from deepkoco.fit.solve.prior import Prior
from tests.fit.identify_logs import TRUE, arm_log, rod_log

TOLERANCE = 1e-4


class Counted:
    """A problem that counts the lanes that it simulates."""

    def __init__(self, problem):
        self.problem, self.lanes, self.predict_itself = problem, 0, problem.predict
        problem.predict = self._predict

    def _predict(self, theta, *rest):
        self.lanes += len(theta)
        return self.predict_itself(theta, *rest)


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


def test_kept_slopes_lead_to_the_same_fit_with_fewer_simulations(arm, trial):
    counted = Counted(arm)
    usual = Batch(arm, [trial], TOLERANCE).run(25)[0]
    many, counted.lanes = counted.lanes, 0
    kept = LazyBatch(arm, [trial], TOLERANCE).run(25)[0]
    assert kept.converged
    assert kept.exact
    assert abs(kept.cost - usual.cost) < 10.0 * TOLERANCE
    sd = np.sqrt(np.diag(usual.covariance))
    for name, own in zip(trial.free, sd, strict=True):
        assert abs(kept.values[name] - usual.values[name]) < 0.05 * own
    np.testing.assert_allclose(np.sqrt(np.diag(kept.covariance)), sd, rtol=0.02)
    assert counted.lanes < many


def test_known_slopes_are_not_computed_again(arm, trial):
    reference = LazyBatch(arm, [trial], TOLERANCE).run(25)[0]
    names = trial.free[1:]
    known = arm.slopes_at(reference.values, names, reference.state, reference.nuisance)
    values = {**reference.values, trial.free[0]: 1.02 * reference.values[trial.free[0]]}
    counted = Counted(arm)
    start = Trial(trial.name, trial.free, trial.prior, values, reference.state, reference.nuisance)
    found = LazyBatch(arm, [start], TOLERANCE, known, exact=False, renewals=0).run(5)[0]
    assert counted.lanes <= 2 * 13  # each point, and the slope of the parameter that is not known
    assert not found.exact
    assert abs(found.cost - reference.cost) < 0.05


def test_equations_of_kept_slopes_are_those_of_new_ones(arm, trial):
    known = arm.slopes_at(trial.values, trial.free, trial.state, arm.nuisances.none())
    usual = Batch(arm, [trial])
    usual.run(1)
    kept = LazyBatch(arm, [trial], known=known, exact=False, renewals=0)
    kept.run(1)
    for name in ("hpp", "hps", "hss", "gp", "gs"):
        torch.testing.assert_close(
            getattr(kept.normal[0], name), getattr(usual.normal[0], name), rtol=1e-9, atol=1e-6
        )
    assert kept.normal[0].cost == pytest.approx(usual.normal[0].cost, rel=1e-12)


def test_a_fit_that_diverges_at_its_start_ends_without_slopes():
    problem = make_request([rod_log(4.0, 0)], "rod_pendulum", ["mass"]).problem()
    declared = {p.name: p.value for p in problem.system.parameters}
    values = {n: declared.get(n, 0.0) for n in problem.names}
    state = problem.windows.state * np.nan
    prior = Prior.of([problem.system.parameter("mass")])
    found = LazyBatch(problem, [Trial("lost", ("mass",), prior, values, state)]).run(5)[0]
    assert found.diverged
    assert found.values == values
