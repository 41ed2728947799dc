"""Which kind of dry friction logs show: one that holds joints at rest, or MuJoCo's, which lets them creep."""

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.as_engine import as_engine_if_shown, closest
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.left_of_logs import Left, LeftOfLogs
from deepkoco.fit.data.windows import cut_windows, window_length
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system
from deepkoco.systems.stick_slip import Joints, StickSlip

SLIDER = """
<mujoco model="slider"><option timestep="0.001"/>
<worldbody><body><joint name="rail" type="slide" axis="1 0 0" damping="{damping}" frictionloss="{friction}"/>
  <geom type="box" size="0.1 0.1 0.1" mass="2"/></body></worldbody>
<actuator><motor name="push" joint="rail"/></actuator></mujoco>
"""
URDF = """<robot name="slider"><link name="world"/>
<link name="box"><inertial><mass value="2"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="world"/><child link="box"/><axis xyz="1 0 0"/>
<limit lower="-50" upper="50" effort="100" velocity="100"/><dynamics damping="4" friction="3"/></joint></robot>"""
H, NOISE = 0.01, 1e-4


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "slider.xml"
    path.write_text(SLIDER.format(damping=4.0, friction=3.0))
    return load_system(path)


def efforts(seconds=10.0):
    t = np.arange(0.0, seconds, H)
    return t, 3.5 * np.sin(2.0 * np.pi * 0.4 * t) + 1.5 * np.sin(2.0 * np.pi * 0.97 * t)


def recorded(t, effort, place, noise=NOISE, seed=0, command=("push", "1")):
    noise = noise * np.random.default_rng(seed).standard_normal(len(t))
    return Recording(
        {
            command[0]: Series(t, effort, command[1], "command"),
            "q_rail": Series(t, place + noise, "m", "measurement"),
        }
    )


def from_mujoco(damping=4.0, friction=3.0, step=0.001, noise=NOISE, **named):
    model = mujoco.MjModel.from_xml_string(SLIDER.format(damping=damping, friction=friction))
    model.opt.timestep = step
    data, place = mujoco.MjData(model), []
    t, effort = efforts()
    for u in effort:
        place.append(float(data.qpos[0]))
        for _ in range(round(H / model.opt.timestep)):
            data.ctrl[:] = u
            mujoco.mj_step(model, data)
    return recorded(t, effort, np.array(place), noise, **named)


def from_a_joint_that_sticks(system, **named):
    law, one = StickSlip(system, system.default_parameters()), torch.zeros(1, dtype=torch.float64)
    joints, place = Joints((one,), (one,), (one,), ()), []
    t, effort = efforts()
    for u in effort:
        place.append(float(joints.angles[0]))
        for _ in range(5):
            joints = law.tick(joints, (torch.full((1,), u, dtype=torch.float64),), H / 5)
    return recorded(t, effort, np.array(place), **named)


def from_rigid_bodies(step=0.005, noise=2e-6, damping=4.0, friction=3.0, mass=2.0, late=0):
    """Semi-implicit steps; dry friction takes what is left of a step's speed, or stops the joint.

    Commands act some steps after they were sent.
    """
    t = np.arange(0.0, 10.0, step)
    effort = 3.5 * np.sin(2.0 * np.pi * 0.4 * t) + 1.5 * np.sin(2.0 * np.pi * 0.97 * t)
    place, speed, places = 0.0, 0.0, []
    for u in np.concatenate([np.repeat(effort[:1], late), effort])[: len(t)]:
        places.append(place)
        speed += step * (u - damping * speed) / mass
        speed = np.sign(speed) * max(abs(speed) - step * friction / mass, 0.0)
        place += step * speed
    return recorded(t, effort, np.array(places), noise)


def test_logs_decide_between_friction_that_holds_and_friction_that_creeps(slider):
    assert as_engine_if_shown([from_mujoco()], slider, window_length(slider)).engine == "MuJoCo"
    assert (
        as_engine_if_shown([from_a_joint_that_sticks(slider)], slider, window_length(slider)).engine is None
    )


@pytest.mark.parametrize("step", [0.0002, 0.0025])
def test_logs_tell_the_steps_of_the_engine_where_they_are_not_those_of_the_file(slider, step):
    found = as_engine_if_shown([from_mujoco(step=step, noise=2e-6)], slider, window_length(slider))
    assert found.engine == "MuJoCo"
    period = 0.01  # of the log
    assert found.engine_step == pytest.approx(period / round(period / found.engine_step), rel=1e-6)
    assert found.engine_step == pytest.approx(step, abs=1e-4)


@pytest.mark.parametrize("step", [0.002, 0.005])
def test_logs_of_another_engine_have_its_steps_and_a_friction_that_holds(slider, step):
    # A healthy arm in Bullet left 9.7 noise variances as a machine, 6.3 as in MuJoCo, 0.84 so.
    found = as_engine_if_shown([from_rigid_bodies(step)], slider, window_length(slider))
    assert found.engine == "semi-implicit"
    assert found.engine_step == pytest.approx(step, rel=1e-6)  # a whole number of them between two commands


def test_late_commands_do_not_hide_the_steps_of_another_engine(slider):
    # One step late is half a step late in all: nearer to a machine than to an engine without a delay.
    windows = cut_windows(
        [from_rigid_bodies(noise=4e-6, friction=0.8, late=1)], slider, window_length(slider)
    )
    left, rigid = LeftOfLogs(windows), slider.with_engine("semi-implicit", 0.005)
    assert left(slider).per_sample < left(rigid).per_sample
    found = as_engine_if_shown(
        [from_rigid_bodies(noise=4e-6, friction=0.8, late=1)], slider, window_length(slider)
    )
    assert found.engine == "semi-implicit"
    assert found.engine_step == pytest.approx(0.005, rel=1e-6)


def test_whole_windows_of_another_engine_leave_only_noise(slider):
    # Friction that turned a joint in a step acted for the whole step before, and 1.18 noise variances were left.
    system = slider.with_engine("semi-implicit", 0.005)
    windows = cut_windows([from_rigid_bodies(0.005)], system, window_length(slider))
    fit = refit(baseline_from(system, windows), windows)
    assert fit.chi2 / windows.samples < 1.1
    assert fit.values["frictionloss(rail)"] == pytest.approx(3.0, rel=2e-3)
    assert fit.values["damping(rail)"] == pytest.approx(4.0, rel=2e-3)


@pytest.mark.parametrize("share", [0.1, 0.24, 0.3, 1.0, 2.1])
@pytest.mark.parametrize("much", [3.0, 300.0])
def test_short_and_long_steps_of_another_engine_are_found(slider, share, much):
    best = share * slider.with_engine("semi-implicit").engine_step

    def left(law):
        if law.engine == "MuJoCo":
            return Left(1e7, 900.0)
        away = (0.0 if law.engine is None else law.engine_step) / best - 1.0
        return Left(1e4 * (0.9 + much * away**2), 0.9 + much * away**2)

    assert closest(slider, left)[0].engine_step == pytest.approx(best, rel=0.05)


def test_a_step_of_mujoco_is_asked_for_where_that_of_the_file_leaves_only_noise(slider):
    # A healthy arm in steps of 0.5 ms: 1.05 noise variances in those of 2 ms, 0.85 in its own.
    def left(law):
        if law.engine != "MuJoCo":
            return Left(1e5, 7.7)
        away = 0.02 * (law.engine_step / 0.00025 - 1.0) ** 2
        return Left(1e4 * (0.85 + away), 0.85 + away)

    assert left(slider.with_engine()).per_sample < 1.2
    found, leaves = closest(slider, left)
    assert (found.engine, found.engine_step) == ("MuJoCo", pytest.approx(0.00025))
    assert leaves.per_sample == pytest.approx(0.85)


def test_a_step_of_mujoco_is_asked_for_where_a_machine_leaves_only_noise(slider):
    # A healthy arm of five servos in steps of 0.5 ms: 0.98 noise variances as a machine, 1.21 in steps of 2 ms.
    def left(law):
        if law.engine != "MuJoCo":
            return Left(9.8e3, 0.98)
        away = 0.4 * (law.engine_step / slider.with_engine().engine_step - 0.25) ** 2
        return Left(1e4 * (0.85 + away), 0.85 + away)

    assert left(slider).less_than(left(slider.with_engine()))
    found, leaves = closest(slider, left)
    assert (found.engine, found.engine_step) == ("MuJoCo", pytest.approx(0.00025))
    assert leaves.per_sample == pytest.approx(0.85)


def test_a_machine_that_does_not_lie_on_the_parabola_does_not_hide_shorter_steps(slider):
    # Beside a delay of the commands, the half step of an engine shows no more, and its friction alone tells the step:
    # 1.66 noise variances as a machine, 3.46, 1.07 and 0.97 in steps of 4, 1 and 0.5 ms, which a log of 0.5 ms left.
    ms = 0.5 * slider.with_engine("semi-implicit").engine_step
    known = {0.0: 1.66, 4.0: 3.46, 1.333: 1.14}

    def left(law):
        if law.engine == "MuJoCo":
            return Left(5e4, 14.0)
        step = round((law.engine_step or 0.0) / ms, 3) if law.engine else 0.0
        per_sample = known.get(step, 0.97 + 0.4 * (step - 0.5) ** 2)
        return Left(3600.0 * per_sample, per_sample)

    def nearest(step):
        return 4.0 * ms / max(round(4.0 * ms / step), 1)

    found, leaves = closest(slider, left, nearest)
    assert (found.engine, found.engine_step) == ("semi-implicit", pytest.approx(0.5 * ms))
    assert leaves.per_sample == pytest.approx(0.97)


def test_the_step_of_every_logged_command_is_tried_first(slider):
    # Costs of short steps need not lead to it: a joint that turns leaves many minima.
    def left(law):
        if law.engine == "MuJoCo":
            return Left(1e6, 50.0)
        known = {None: 10.6, 0.005: 1.0, 0.0025: 13.9}
        per_sample = known.get(law.engine_step, 6.0)
        return Left(1e4 * per_sample, per_sample)

    def nearest(step):
        return 0.005 / max(round(0.005 / step), 1)

    assert closest(slider, left, nearest)[0].engine_step == 0.005


def test_logs_that_no_step_follows_better_are_of_a_machine(slider):
    asked = []

    def left(law):
        asked.append(law.engine)
        step = law.engine_step or 0.0
        return Left(1e4 * (3.0 + 1e3 * step), 3.0 + 1e3 * step)

    assert closest(slider, left)[0] is slider
    assert asked.count("semi-implicit") == 2


@pytest.mark.parametrize("best", [0.0005, 0.002, 0.02])
def test_a_robot_that_its_file_describes_badly_is_a_machine_after_few_fits(slider, best):
    asked = []

    def left(law):
        asked.append((law.engine, law.engine_step))
        step = law.engine_step or 0.0
        leaves = 60.0 + 30.0 * min((step / best - 1.0) ** 2, 10.0)
        return Left(1e4 * leaves, leaves)

    assert closest(slider, left)[0] is slider
    assert len(asked) <= 9
    assert len([name for name, _ in asked if name == "semi-implicit"]) <= 4


def test_a_model_file_that_states_steps_keeps_them(slider):
    stated = slider.with_engine(step=0.0005)
    assert as_engine_if_shown([from_mujoco(step=0.0025, noise=2e-6)], stated, window_length(slider)) is stated


def test_logs_of_a_urdf_robot_may_come_from_an_engine_of_which_the_file_says_nothing(tmp_path):
    # As a machine, a healthy simulated arm of four joints left 4.7 noise variances instead of 0.84.
    path = tmp_path / "slider.urdf"
    path.write_text(URDF)
    slider, command = load_system(path), ("rail", "N")
    simulated = from_mujoco(step=0.0005, noise=2e-6, command=command)
    found = as_engine_if_shown([simulated], slider, window_length(slider))
    assert (found.engine, found.engine_step) == ("MuJoCo", pytest.approx(0.0005, abs=2e-4))
    sticking = from_a_joint_that_sticks(slider, command=command)
    assert as_engine_if_shown([sticking], slider, window_length(slider)).engine is None


def test_a_robot_without_dry_friction_and_with_exact_steps_is_a_machine(tmp_path):
    path = tmp_path / "free.xml"
    path.write_text(SLIDER.replace("timestep", 'integrator="RK4" timestep').format(damping=4.0, friction=0.0))
    free = load_system(path)
    assert as_engine_if_shown([from_mujoco(friction=0.0)], free, window_length(free)) is free


@pytest.mark.study
def test_a_healthy_log_of_a_simulated_robot_lacks_nothing(slider):
    assert diagnose([from_mujoco()], slider).verdict == "nothing"


@pytest.mark.study
def test_more_friction_of_a_simulated_robot_is_named(slider):
    found = diagnose([from_mujoco(friction=4.5)], slider)
    assert found.verdict == "cause"
    names = {name for finding in found.causes for name in finding.members}
    assert names & {"coulomb", "changed(frictionloss(rail))", "coulomb(rail)"}
