"""Priors that count as much as the data, and the causes of several joints that are accepted together."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.joint_by_joint import best_of_each_joint
from deepkoco.diagnose.evidence.promising import PER_PLACE, best_of_each_place
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking
from deepkoco.diagnose.evidence.screening import StartPoint
from deepkoco.diagnose.evidence.selected import on_refit
from deepkoco.diagnose.tempered import tempered_to, told
from deepkoco.fit import cut_windows
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.systems import make_system
from tests.fit.identify_logs import arm_log


@pytest.fixture(scope="module")
def arm():
    system = make_system("two_link_arm")
    windows = cut_windows([arm_log(0)], system, 1.0)
    start = baseline_from(system, windows)
    return start, windows, refit(start, windows)


def test_tempered_prior_is_narrower_by_the_deflation_and_at_least_as_wide_as_the_distance(arm):
    start, windows, fit = arm
    name, far = start.prior.names[:2]
    sd = dict(zip(start.prior.names, np.sqrt(start.prior.covariance.diagonal()), strict=True))
    values = {**fit.values, name: start.values[name] + 0.5 * sd[name], far: start.values[far] + 7.0 * sd[far]}
    moved = replace(fit, values=values, residual=10.0 * fit.residual)
    tempered = tempered_to(start, (name, far), moved, windows)
    deflation = dispersion(moved, windows).deflation
    assert deflation > 50.0
    assert tempered.tempering == pytest.approx(deflation)
    np.testing.assert_allclose(
        np.sqrt(deflation * tempered.prior.covariance.diagonal()), [sd[name], 7.0 * sd[far]]
    )
    np.testing.assert_array_equal(tempered.prior.centre, [start.values[name], start.values[far]])


def test_told_leaves_out_what_a_log_tells_less_of_than_the_prior(arm):
    start, _, fit = arm
    names = start.prior.names
    information = np.diag(1.0 / start.prior.covariance.diagonal())
    information[0, 0] *= 1e-3
    some = replace(fit, information=information, free=names)
    assert told(start, some) == names[1:]


def ranked(arm, scores):
    """A ranking of these causes with these falls of the BIC; a cause with None was not fitted."""
    start, windows, fit = arm
    known = catalogue(start.system.base)
    candidates = [
        Candidate(known[n], fit if s is None else replace(fit, name=n), 0.0, 50.0 if s is None else s)
        for n, s in scores.items()
    ]
    candidates.sort(key=lambda c: -c.delta_bic)
    return Ranking(fit, tuple(candidates), dispersion(fit, windows), 1.0, 100.0)


def test_best_of_each_joint_leaves_out_pushes_what_is_weak_and_what_was_not_fitted(arm):
    joints = arm[0].system.base.joint_names
    one, two = (f"({j})" for j in joints)
    ranking = ranked(
        arm,
        {
            f"event{one}": 90.0,
            f"coulomb{one}": 70.0,
            f"viscous{one}": 60.0,
            f"quadratic{two}": None,
            f"coulomb{two}": 35.0,
            "sensing_delay": 20.0,
        },
    )
    assert [c.cause.name for c in best_of_each_joint(ranking, 30.0)] == [f"coulomb{one}", f"coulomb{two}"]


def test_a_ranking_beside_causes_that_were_removed_since_is_not_taken_for_one_on_the_refit(arm):
    one = ranked(arm, {"sensing_delay": 50.0})
    beside = replace(one, beside=("spring(joint 2)",))
    assert on_refit([(beside, ("sensing_delay",)), (one, ("sensing_delay",))]) is one
    assert on_refit([(beside, ("sensing_delay",))]) is None
    assert on_refit([]) is None


def test_best_of_each_place_keeps_as_many_causes_of_every_joint(arm):
    known = catalogue(arm[0].system.base)
    at = {j: [c for c in known.values() if c.joint == j and c.free][: PER_PLACE + 2] for j in (0, 1)}
    points = [
        StartPoint(cause, {}, 100.0 * (2 - j) + k) for j, own in at.items() for k, cause in enumerate(own)
    ]
    kept = best_of_each_place(points, {p.cause.name: 0.0 for p in points})
    assert {p.cause.name for p in kept} == {c.name for own in at.values() for c in own[-PER_PLACE:]}
