"""The rate gain of a servo follows its stiffness; what it loses is damping of the joint."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.one_controller import with_gains_tied, with_surplus_as_damping
from tests.fit.test_scale_search import stiff

__all__ = ["stiff"]
NAMES = ("kp(m_shoulder)", "kv(m_shoulder)", "damping(shoulder)")


@pytest.fixture(scope="module")
def start(stiff):
    system, soft, _ = stiff
    return baseline_from(system, soft)


def tied(start, values, settled=True, names=NAMES):
    # Of the model: kp 900 N m/rad, kv 2 N m s/rad, known to 30 %.
    covariance = np.diag([880.0**2, 1.0, 0.25])[: len(names), : len(names)]
    return with_gains_tied(start, names, {**start.values, **values}, settled, covariance)


def test_rate_gain_has_the_distance_of_the_stiffness_and_differs_by_its_own_share(start):
    covariance = tied(start, {"kp(m_shoulder)": 90.0, "kv(m_shoulder)": 0.2})
    ratio = 2.0 / 900.0
    assert covariance[0, 1] == pytest.approx(ratio * 880.0**2)
    # At a tenth of the stiffness, 30 % of a tenth of 2 N m s/rad.
    assert covariance[1, 1] == pytest.approx((ratio * 880.0) ** 2 + 0.06**2)
    assert covariance[2, 2] == 0.25
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_rate_gain_that_a_settled_fit_has_elsewhere_keeps_its_prior(start):
    away = {"kp(m_shoulder)": 90.0, "kv(m_shoulder)": 1.5}
    assert tied(start, away)[0, 1] == 0.0
    assert tied(start, away, settled=False)[0, 1] > 0.0


def test_rate_gain_of_a_joint_without_damping_stands_for_that_too(start):
    prior = start.prior
    names = tuple(n for n in prior.names if not n.startswith("damping"))
    index = [prior.names.index(n) for n in names]
    own = replace(
        prior, names=names, centre=prior.centre[index], covariance=prior.covariance[np.ix_(index, index)]
    )
    without = replace(start, prior=own)
    assert tied(without, {"kp(m_shoulder)": 90.0, "kv(m_shoulder)": 0.2}, names=NAMES[:2])[0, 1] == 0.0


def test_surplus_of_a_rate_gain_becomes_damping(start):
    values = {**start.values, "kp(m_shoulder)": 90.0, "kv(m_shoulder)": 1.2, "damping(shoulder)": 0.1}
    moved = with_surplus_as_damping(start, values)
    assert moved["kv(m_shoulder)"] == pytest.approx(0.2)
    assert moved["damping(shoulder)"] == pytest.approx(1.1)
    # A loss cannot be negative: of the 1.9 N m s/rad that are missing, the damping has 0.1.
    values["kv(m_shoulder)"], values["kp(m_shoulder)"] = 0.1, 900.0
    moved = with_surplus_as_damping(start, values)
    assert (moved["damping(shoulder)"], moved["kv(m_shoulder)"]) == pytest.approx((0.0, 0.2))
