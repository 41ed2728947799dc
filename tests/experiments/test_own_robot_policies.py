"""Units on which policies are judged, against the solver that makes the logs of the same units."""

import numpy as np
import pytest

from deepkoco.systems import load_system
from experiments.studies.learning.own_robot_policies.__main__ import EXAMPLES, Zero, interval
from experiments.studies.learning.own_robot_policies.tasks import Swing
from experiments.studies.learning.own_robot_policies.units import (
    EquationUnit,
    MujocoUnit,
    UnitEnv,
    arm_hidden,
    arm_model,
    true_arm,
)
from tests.oracle.own_robots import CartPoleUnit, _integrate


def test_unit_with_a_delay_moves_as_the_log_of_the_oracle():
    oracle, t = CartPoleUnit(delay=0.06), np.arange(21) * 0.04
    force = np.repeat([4.0, -6.0, 2.0, 0.0], 6)[:21]
    unit = EquationUnit(oracle, 4, 4e-3)
    unit.reset(np.zeros(4))
    found = []
    for u in force[:-1]:
        unit.advance(np.array([u]), 0.04)
        found.append(unit.state)
    expected = _integrate(oracle._slope, np.zeros(4), t, force, oracle.delay)[1:]
    assert np.abs(expected[:, 1]).max() > 0.3
    np.testing.assert_allclose(found, expected, atol=1e-5)


def unit_env(history: int = 2) -> UnitEnv:
    system = load_system(f"{EXAMPLES / 'cart_pole.py'}:CartPole")
    return UnitEnv(EquationUnit(CartPoleUnit(), 4, 4e-3), system, Swing(), 5, history)


def test_episode_pays_the_task_and_shows_past_actions():
    env = unit_env()
    first, _ = env.reset(seed=1)
    again, _ = env.reset(seed=1)
    np.testing.assert_array_equal(first, again)
    pole = env.unit.state[1]
    seen, reward, ended, cut, _ = env.step(np.array([0.5], np.float32))
    assert -reward == pytest.approx(
        1.0 + np.cos(pole) + 0.2 * env.unit.state[0] ** 2 + 0.001 * 25.0, abs=0.02
    )
    assert seen[-2:].tolist() == [0.5, 0.0]
    assert not ended
    assert not cut
    for _ in range(4):
        *_, cut, _ = env.step(np.zeros(1, np.float32))
    assert cut


def test_the_true_arm_as_a_file_moves_as_the_unit(tmp_path):
    import mujoco

    (tmp_path / "true.xml").write_text(true_arm())
    file = mujoco.MjModel.from_xml_path(str(tmp_path / "true.xml"))
    unit = arm_model(arm_hidden())
    for name in ("body_mass", "dof_damping", "dof_frictionloss", "dof_armature"):
        np.testing.assert_allclose(getattr(file, name), getattr(unit, name), rtol=1e-5)
    assert unit.dof_frictionloss[0] > 2.0  # what is hidden
    moved = MujocoUnit(unit)
    moved.reset(np.array([0.2, 0.1, 0.0, 0.0]))
    moved.advance(np.array([1.0, 0.0]), 0.1)
    assert abs(moved.state[0] - 0.2) < 1e-4  # dry friction holds it


def test_interval_holds_the_mean():
    costs = np.random.default_rng(0).normal(50.0, 10.0, 60)
    found = interval(costs, 0)
    assert found["low"] < found["mean"] < found["high"]
    assert found["high"] - found["low"] == pytest.approx(2 * 1.96 * 10.0 / np.sqrt(60), rel=0.3)
    assert Zero(3, 2).act(None).shape == (3, 2)
