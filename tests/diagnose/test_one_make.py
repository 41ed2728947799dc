"""Servos of one make share how far they are from the model, and differ from each other as units do."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.causes.cause import Hint
from deepkoco.diagnose.evidence.far_parameters import far_names
from deepkoco.diagnose.one_make import covariance_of, groups_of
from deepkoco.diagnose.tempered import told
from deepkoco.systems import make_system
from tests.fit.test_scale_search import stiff

__all__ = ["stiff"]
NAMES = ("kp(m_shoulder)", "kp(m_elbow)", "mass(upper)", "kv(m_shoulder)")


@pytest.fixture(scope="module")
def start(stiff):
    system, soft, _ = stiff
    return baseline_from(system, soft)


def test_groups_hold_drives_with_one_value_and_no_bodies(start):
    assert groups_of(start, NAMES) == [[0, 1]]


def test_servos_share_their_distance_and_differ_as_units_do(start):
    values = {**start.values, NAMES[0]: 16.0, NAMES[1]: 20.0}
    covariance = covariance_of(start, NAMES, values, True)
    level, share = 18.0, 0.2
    assert covariance[0, 1] == pytest.approx((900.0 - level) ** 2)
    assert covariance[0, 0] - covariance[0, 1] == pytest.approx((share * level) ** 2)
    assert covariance[2, 2] == pytest.approx(start.system.parameter(NAMES[2]).prior_sd ** 2)
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_a_servo_that_a_settled_fit_has_far_from_the_others_leaves_the_group(start):
    values = {**start.values, NAMES[0]: 16.0, NAMES[1]: 600.0}
    assert covariance_of(start, NAMES, values, False)[0, 1] > 0.0
    apart = covariance_of(start, NAMES, values, True)
    assert apart[0, 1] == 0.0
    assert apart[0, 0] == pytest.approx((900.0 - 16.0) ** 2)


def test_far_is_what_is_two_declared_deviations_off_with_its_whole_interval(start):
    names = NAMES[:2]
    fit: Any = SimpleNamespace(
        values={**start.values, names[0]: 20.0, names[1]: 20.0},
        free=names,
        covariance=np.diag([10.0**2, 400.0**2]),
    )
    assert far_names(start, fit, 1.0) == [names[0]]
    assert far_names(start, fit, 1e4) == []


def rate_limits(system, fastest):
    cause = next(c for n, c in catalogue(system).items() if n.startswith("rate_limit") and c.joint == 0)
    hint = Hint(system, 0, np.array([0.0, 1.0]), np.array([-fastest, 0.1]), (), 10.0, 1.0, None)
    return [limit for place in cause.starts(hint) for limit in place.values()]


def test_a_limited_goal_is_searched_for_where_the_joint_was_fastest(stiff):
    assert {0.3, 0.4, 0.5} <= {round(limit, 6) for limit in rate_limits(stiff[0], 0.5)}


def test_the_rate_of_a_torque_has_nothing_to_do_with_the_speed():
    arm = make_system("two_link_arm")
    assert rate_limits(arm, 0.5) == rate_limits(arm, 5.0)


def test_what_a_log_tells_of_one_servo_keeps_the_others_of_its_make_free(start):
    told_of = dict.fromkeys(start.prior.names, 0.0) | {NAMES[0]: 1e6}
    information = np.diag([told_of[n] for n in start.prior.names])
    fit: Any = SimpleNamespace(information=information, free=start.prior.names)
    assert set(told(start, fit)) == set(NAMES[:2])
