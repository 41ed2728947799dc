"""A fit starts from a rate gain in proportion to the stiffness; what it loses is damping of the joint."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.one_controller import with_surplus_as_damping
from deepkoco.systems import load_system
from tests.fit.test_scale_search import stiff

__all__ = ["stiff"]


@pytest.fixture(scope="module")
def start(stiff):
    system, soft, _ = stiff
    return baseline_from(system, soft)


def test_surplus_of_a_rate_gain_becomes_damping(start):
    values = {**start.values, "kp(m_shoulder)": 90.0, "kv(m_shoulder)": 1.2, "damping(shoulder)": 0.1}
    moved = with_surplus_as_damping(start, values)
    assert moved["kv(m_shoulder)"] == pytest.approx(0.2)
    assert moved["damping(shoulder)"] == pytest.approx(1.1)
    # A loss cannot be negative: of the 1.9 N m s/rad that are missing, the damping has 0.1.
    values["kv(m_shoulder)"], values["kp(m_shoulder)"] = 0.1, 900.0
    moved = with_surplus_as_damping(start, values)
    assert (moved["damping(shoulder)"], moved["kv(m_shoulder)"]) == pytest.approx((0.0, 0.2))


def test_rate_gain_of_a_joint_without_damping_stands_for_that_too(start):
    prior = start.prior
    names = tuple(n for n in prior.names if not n.startswith("damping"))
    index = [prior.names.index(n) for n in names]
    own = replace(
        prior, names=names, centre=prior.centre[index], covariance=prior.covariance[np.ix_(index, index)]
    )
    values = {**start.values, "kp(m_shoulder)": 90.0, "kv(m_shoulder)": 1.2}
    assert with_surplus_as_damping(replace(start, prior=own), values) == values


def test_two_servos_of_a_joint_both_become_damping(tmp_path, stiff):
    servos = "".join(f'<position name="{n}" joint="hinge" kp="10" kv="1"/>' for n in ("near", "far"))
    (tmp_path / "arm.xml").write_text(
        f"""<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.5"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/></body></worldbody>
        <actuator>{servos}</actuator></mujoco>"""
    )
    arm = load_system(tmp_path / "arm.xml")
    start = baseline_from(arm, stiff[1].take(np.zeros(0, dtype=int)))
    values = {**start.values, "kv(near)": 3.0, "kv(far)": 2.0}
    moved = with_surplus_as_damping(start, values)
    gains = ("kv(near)", "kv(far)", "damping(hinge)")
    assert sum(moved[n] for n in gains) == pytest.approx(sum(values[n] for n in gains))
