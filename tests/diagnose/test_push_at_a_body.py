"""A force that pushes a body for a while: found as one, with its size, its place and its time."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import deepkoco
from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import Healthy, baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.seen_when_healthy import healthy_shows_pushes
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.data.windows import cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem
from deepkoco.logs.recording import Recording, Series

CRANE = """<mujoco model="crane"><option integrator="implicitfast" timestep="0.001"/><worldbody>
<body name="trolley"><joint name="trolley" type="slide" axis="1 0 0" damping="{damping}"/>
<inertial pos="0 0 0" mass="12" diaginertia="0.1 0.1 0.1"/>
<body name="load"><joint name="sway" axis="0 1 0" damping="0.03"/>
<inertial pos="0 0 -0.8" mass="{mass}" diaginertia="0.02 0.02 0.02"/></body></body></worldbody>
<actuator><motor name="drive" joint="trolley" ctrlrange="-100 100" ctrllimited="true"/></actuator></mujoco>"""
RATE, SECONDS, NOISE = 50, 20.0, (1e-4, 5e-4)


def moved(force, low, begins, lasts, seed=3, aside=0.0):
    """Log of a crane whose load is pushed at a point this far below its centre of mass, and this far beside it."""
    model = mujoco.MjModel.from_xml_string(CRANE.format(damping=14.7, mass=3.95))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    t, load = np.arange(0.0, SECONDS, 1.0 / RATE), model.body("load").id
    tones, phases = rng.uniform(0.1, 0.6, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
    goal = 0.2 * np.sin(2.0 * np.pi * tones * t[:, None] + phases).sum(1)
    shown, sent = np.empty((2, len(t))), np.empty(len(t))
    for k, wanted in enumerate(goal):
        shown[:, k] = data.qpos + NOISE * rng.normal(size=2)
        sent[k] = np.clip(300.0 * (wanted - data.qpos[0]) - 60.0 * data.qvel[0], -100.0, 100.0)
        data.ctrl[0] = sent[k]
        for _ in range(round(1000 / RATE)):
            data.qfrc_applied[:] = 0.0
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            if begins <= data.time < begins + lasts:
                turn = data.xmat[load].reshape(3, 3)
                point = data.xipos[load] - low * turn[:, 2] + aside * turn[:, 0]
                mujoco.mj_applyFT(model, data, np.array(force), np.zeros(3), point, load, data.qfrc_applied)
            mujoco.mj_step(model, data)
    channels = {
        "q_trolley": Series(t, shown[0], "m", "measurement"),
        "q_sway": Series(t, shown[1], "rad", "measurement"),
        "drive": Series(t, sent, "N", "command"),
    }
    return Recording(channels)


@pytest.mark.study
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("force", "low", "begins", "lasts"),
    [
        pytest.param((6.5, 0.0, 0.0), 0.0, 13.2, 1.0, marks=pytest.mark.long),
        ((-9.0, 0.0, 4.0), 0.15, 7.31, 0.2),
        pytest.param((2.5, 0.0, 0.0), 0.0, 8.9, 3.3, marks=pytest.mark.long),
    ],
)
def test_a_push_at_a_hanging_load_is_told_by_its_force_its_point_and_its_time(
    tmp_path, force, low, begins, lasts
):
    (tmp_path / "crane.xml").write_text(CRANE.format(damping=15.0, mass=4.0))
    robot = deepkoco.load_system(tmp_path / "crane.xml")
    found = diagnose(
        [moved(force, low, begins, lasts)], robot, only=["event", "body_push", "viscous", "payload", "gain"]
    )
    assert found.names == ("body_push(load)",)
    sizes = found.causes[0].parameters
    assert sizes["event.x"].value == pytest.approx(force[0], rel=0.05)
    assert sizes["event.start"].value == pytest.approx(begins, abs=0.05)
    assert sizes["event.duration"].value == pytest.approx(lasts, abs=0.1)
    assert sizes["event.along"].low < low < sizes["event.along"].high


@pytest.mark.study
@pytest.mark.timeout(300)
def test_a_crane_that_nobody_pushes_shows_no_push(tmp_path):
    (tmp_path / "crane.xml").write_text(CRANE.format(damping=15.0, mass=4.0))
    robot = deepkoco.load_system(tmp_path / "crane.xml")
    log = moved((0.0, 0.0, 0.0), 0.0, 5.0, 0.0)
    assert diagnose([log], robot, only=["event", "body_push", "viscous", "payload", "gain"]).names == ()


@pytest.mark.study
@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_rope_at_the_side_of_a_load_is_told_by_its_line_of_action(tmp_path):
    (tmp_path / "crane.xml").write_text(CRANE.format(damping=15.0, mass=4.0))
    robot = deepkoco.load_system(tmp_path / "crane.xml")
    log = moved((5.0, 0.0, -8.0), 0.1, 9.3, 2.4, aside=0.12)
    found = diagnose([log], robot, only=["event", "body_push", "viscous", "payload", "gain"])
    assert found.names == ("body_push(load)",)
    sizes = found.causes[0].parameters
    assert sizes["event.x"].value == pytest.approx(5.0, rel=0.05)
    assert sizes["event.start"].value == pytest.approx(9.3, abs=0.05)
    # A force shows its line of action, and all points on it are one: the swing of the load hardly turns it.
    assert found.chi2_after < 1.1
    x, z, low, aside = (sizes[f"event.{n}"].value for n in ("x", "z", "along", "across"))
    # Across the link is -x of the load's frame: axis times the direction of the link.
    assert (0.8 + low) * x - aside * z == pytest.approx(0.9 * 5.0 - 0.12 * 8.0, rel=0.1)


def refitted(robot, force):
    """Baseline, windows and refit of a log of the crane whose load is pushed with this force."""
    windows = cut_windows([moved(force, 0.0, 13.2, 1.0)], robot, window_length(robot))
    start = baseline_from(robot, windows)
    windows, reference = refit_sharply(start, windows.take(moving(windows)))
    return start, windows, reference


@pytest.mark.study
@pytest.mark.parametrize(("usual", "shown"), [(6.5, True), (0.0, False), (0.5, False)])
def test_a_push_at_a_body_is_usual_where_healthy_logs_show_one_nearly_as_strong(tmp_path, usual, shown):
    (tmp_path / "crane.xml").write_text(CRANE.format(damping=15.0, mass=4.0))
    robot = deepkoco.load_system(tmp_path / "crane.xml")
    before, healthy, fit = refitted(robot, (usual, 0.0, 0.0))
    start = replace(before, healthy=Healthy((), healthy, before, (), fit))
    _, windows, reference = refitted(robot, (6.5, 0.0, 0.0))
    missing = missing_torque(FitProblem(start.system, windows), reference)
    push = catalogue(robot)["body_push(load)"]
    assert healthy_shows_pushes(start, windows, missing, push) == shown
