"""The study of public arms: its cases, and that its units do what a case says.

Two hinges with vertical axes on branches of their own move without gravity and without each other, so that each obeys
J dv/dt = u(t - delay) - d v - friction sign(v). Coefficients of this equation are regressed on the log.
"""

import numpy as np
import pytest

from deepkoco.systems import load_system
from experiments.studies.diagnosis import public_arms
from experiments.studies.diagnosis.public_arms import ARMS, HIDDEN, RATE, Case, draw_case, record, settings_of

STATED = 0.4  # dry friction in the file [N m]
LINK = (
    '<inertial><mass value="1.0"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
JOINT = (
    '<joint name="{0}" type="revolute"><parent link="base"/><child link="{0}_link"/><axis xyz="0 0 1"/>'
    '<limit lower="-2" upper="2" effort="100" velocity="100"/><dynamics damping="0.3" friction="{1}"/></joint>'
)
NAMES = ("left", "right", "gripper")


@pytest.fixture
def arm(tmp_path, monkeypatch):
    """An arm whose third joint is held, and its file; logs of 6 s without noise."""
    monkeypatch.setattr(public_arms, "SECONDS", 6.0)
    monkeypatch.setattr(public_arms, "STEP", 2.5e-4)
    monkeypatch.setattr(public_arms, "NOISE", (0.0, 0.0))
    links = "".join(f'<link name="{name}_link">{LINK}</link>' for name in NAMES)
    joints = "".join(JOINT.format(name, STATED) for name in NAMES)
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm"><link name="base"/>{links}{joints}</robot>')
    return path, load_system(settings_of(path, NAMES[:2]))


def moved(log, joint):
    """Speed (n,) and command (n,) of a joint."""
    speed, command = (
        next(s for name, s in log.channels.items() if joint in name and s.kind == kind and s.unit == unit)
        for kind, unit in (("measurement", "rad/s"), ("command", "N m"))
    )
    return speed.value, command.value


def regressed(speed, command, delay):
    """Friction over the gain of the command, and the error left, for a command that acts late by this delay [s]."""
    at = np.arange(len(command)) / RATE
    # Mean of the held command over each sample interval, as it acts.
    share = np.cumsum(np.concatenate([[0.0], command])) / RATE
    edges = np.append(at, at[-1] + 1.0 / RATE)
    acting = np.diff(np.interp(edges - delay, edges, share))[:-1] * RATE
    change, middle = np.diff(speed) * RATE, 0.5 * (speed[1:] + speed[:-1])
    # Not while the joint may stick, and not before the first command acts.
    moves = (np.abs(middle) > 0.1) & (at[:-1] > 0.1)
    terms = np.stack([acting, middle, np.sign(middle)], 1)[moves]
    found, *_ = np.linalg.lstsq(terms, change[moves], rcond=None)
    left = change[moves] - terms @ found
    return -found[2] / found[0], float(np.sqrt((left**2).mean()))


def test_all_robots_with_all_that_can_be_hidden_are_drawn():
    drawn = [draw_case(5, k) for k in range(len(ARMS) * len(HIDDEN))]
    assert {(c.robot, c.hidden) for c in drawn} == {(robot, hidden) for robot in ARMS for hidden in HIDDEN}
    assert all(c.joint in ARMS[c.robot] for c in drawn)


def test_a_case_and_its_log_follow_from_the_seed(arm):
    path, system = arm
    assert draw_case(5, 3) == draw_case(5, 3)
    assert draw_case(5, 3).seed != draw_case(6, 3).seed
    case = Case("arm.urdf", "coulomb", "left", 11)
    (first, size), (again, same) = record(case, path, system), record(case, path, system)
    assert size == same
    for name, series in first.channels.items():
        assert np.array_equal(series.value, again.channels[name].value)


def test_a_hidden_delay_lets_the_command_of_its_joint_act_late(arm):
    path, system = arm
    log, size = record(Case("arm.urdf", "actuation_delay", "right", 3), path, system)
    delays = np.arange(0.0, 0.05, 0.001)
    best = {
        joint: delays[np.argmin([regressed(*moved(log, joint), delay)[1] for delay in delays])]
        for joint in NAMES[:2]
    }
    assert 0.01 <= size <= 0.03
    assert best["right"] == pytest.approx(size, abs=0.001)
    assert best["left"] == pytest.approx(0.0, abs=0.001)


def test_hidden_friction_adds_to_what_the_file_states(arm):
    path, system = arm
    log, size = record(Case("arm.urdf", "coulomb", "left", 3), path, system)
    assert size > 0.05
    assert regressed(*moved(log, "left"), 0.0)[0] == pytest.approx(STATED + size, rel=0.02)
    assert regressed(*moved(log, "right"), 0.0)[0] == pytest.approx(STATED, rel=0.02)


def test_a_healthy_unit_hides_nothing(arm):
    path, system = arm
    log, size = record(Case("arm.urdf", "nothing", "left", 3), path, system)
    assert size == 0.0
    for joint in NAMES[:2]:
        assert regressed(*moved(log, joint), 0.0)[0] == pytest.approx(STATED, rel=0.02)
