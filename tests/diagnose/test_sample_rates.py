"""Logs of different rates in one diagnosis, of a stiff servo whose swing only the fast ones show."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from scipy.linalg import expm

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.healthy import learn_baseline
from deepkoco.fit.data.sample_rate import sampled_as
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import any_system

INERTIA, DAMPING, STIFFNESS = 4e-3, 0.5, 900.0
ONE_JOINT = f"""
<mujoco model="one joint"><option gravity="0 0 0"/><worldbody><body name="b">
<inertial pos="0 0 0" mass="0.4" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
<joint name="j" axis="0 1 0" damping="{DAMPING}"/></body></worldbody>
<actuator><position name="s" joint="j" kp="{STIFFNESS:g}" ctrlrange="-2 2"/></actuator></mujoco>
"""
NOISE = 2e-4  # rad
ONLY = ["gain", "lag", "viscous", "coulomb"]


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """It swings at 474 rad/s and needs steps of 1 ms; at 10 Hz a swing is over by the next sample."""
    path = tmp_path_factory.mktemp("rates") / "robot.xml"
    path.write_text(ONE_JOINT)
    return any_system(str(path))


def log(robot, rate, seconds, seed):
    """Goals of 0.2 s, answered by the exact solution of I q'' + d q' + k (q - u) = 0."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    goals = rng.uniform(-0.3, 0.3, round(seconds / 0.2) + 1)
    goal = goals[np.floor(t / 0.2 + 1e-9).astype(int)]
    step = expm(np.array([[0.0, 1.0], [-STIFFNESS / INERTIA, -DAMPING / INERTIA]]) / rate)
    state, shown = np.zeros(2), []
    for u in goal:  # it holds until the next sample
        shown.append(state[0])
        state = step @ (state - [u, 0.0]) + [u, 0.0]
    measured, command = robot.measurements[0], robot.commands[0]
    return Recording(
        {
            command.name: Series(t, goal, command.unit, "command"),
            measured.name: Series(
                t, shown + NOISE * rng.standard_normal(len(t)), measured.unit, "measurement"
            ),
        }
    )


def test_healthy_logs_are_simulated_as_the_system_that_is_given(robot):
    slow = [log(robot, 10, 12.0, 2)]
    assert sampled_as(robot, slow).longest_step > 5.0 * robot.longest_step
    assert learn_baseline(slow, robot, 1.0, extension=0).system.longest_step == robot.longest_step


@pytest.mark.study
def test_a_fast_log_beside_slower_healthy_ones_is_healthy(robot):
    fast = log(robot, 500, 8.0, 1)
    assert (
        diagnose([fast], robot, healthy=[log(robot, 10, 30.0, 2)], window=1.0, only=ONLY).verdict == "nothing"
    )


@pytest.mark.study
def test_what_a_slow_log_returns_is_the_robot_for_all_purposes(robot):
    model = diagnose([log(robot, 10, 20.0, 2)], robot, window=1.0, only=ONLY).model
    assert model.longest_step == pytest.approx(robot.longest_step, rel=0.1)
    assert diagnose([log(robot, 500, 8.0, 1)], model, window=1.0, only=ONLY).verdict == "nothing"
