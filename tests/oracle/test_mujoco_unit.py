"""Units of MuJoCo: one log for one seed, no misfit where nothing is hidden, the strength that is asked for."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from deepkoco.logs.recording import read_log
from tests.oracle.mujoco_allowed import cost_within_priors
from tests.oracle.mujoco_doses import COARSE, dosed, scaled, strength
from tests.oracle.mujoco_robots import cart_pole, draw_robot, random_arm
from tests.oracle.mujoco_unit import KINDS, Hidden, record, unit_model
from tests.studied import studied

SECONDS = 3.0


def arm(drive="motor", joints=3, seed=3):
    return random_arm(np.random.default_rng(seed), joints, drive)


@pytest.mark.parametrize("seed", range(6))
def test_every_drawn_robot_compiles_and_has_one_actuator_for_each_command(seed):
    robot = draw_robot(np.random.default_rng(seed))
    model = mujoco.MjModel.from_xml_string(robot.xml)
    assert model.nu == len(robot.sizes)
    assert model.nq == model.nv == (2 if robot.name == "cart_pole" else len(robot.sizes))


def test_record_returns_the_same_log_for_the_same_seed():
    first, again, other = (record(arm(), None, seed, SECONDS, step=COARSE) for seed in (5, 5, 6))
    assert np.array_equal(first.readings, again.readings)
    assert not np.array_equal(first.commands[: len(other.commands)], other.commands[: len(first.commands)])


def test_strength_of_a_healthy_log_is_zero():
    assert strength(record(arm(), None, 5, SECONDS, step=COARSE), 5) < 1e-6


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "sensor_bias"])
@pytest.mark.parametrize("drive", studied(["motor", "position"], ("motor",)))
def test_every_kind_of_effect_changes_what_the_healthy_unit_cannot_explain(kind, drive):
    robot = arm(drive)
    log = record(robot, dosed(robot, kind, "j2", 2.0), 5, SECONDS, step=COARSE)
    assert strength(log, 5) > 0.3


def test_a_zero_error_shows_at_a_joint_that_gravity_loads():
    robot = arm("motor")
    log = record(robot, dosed(robot, "sensor_bias", "j2", 3.0), 5, SECONDS, step=COARSE)
    assert strength(log, 5) > 0.3


@pytest.mark.study
@pytest.mark.parametrize(("sds", "cost"), [(0.5, 0.25), (-3.0, 9.0)])
def test_another_gain_of_a_motor_costs_about_its_squared_prior_deviations(sds, cost):
    # The file knows a gain to 20 %. The explained part is 1e9 times as large, so slopes by differences add a little.
    found = cost_within_priors(arm("motor"), Hidden("gain", "j2", 1.0 + 0.2 * sds), 5, SECONDS)
    assert 0.8 * cost < found < 2.0 * cost


@pytest.mark.study
def test_a_heavier_cart_is_a_healthy_cart_and_a_spring_at_it_is_not():
    robot = cart_pole(np.random.default_rng(1))
    mass = float(mujoco.MjModel.from_xml_string(robot.xml).body("cart").mass[0])
    # The file knows the mass to 10 %. Less than 1: only ratios of mass, gain and frictions show, and these vary too.
    assert 0.2 < cost_within_priors(robot, Hidden("payload", "slider", 0.1 * mass), 5, SECONDS) < 1.0
    assert cost_within_priors(robot, Hidden("spring", "slider", 2.0), 5, SECONDS) > 1000.0


def test_a_payload_hangs_where_it_is_said_to_hang():
    robot = arm(seed=20)
    plain, loaded = (unit_model(robot, h, 5) for h in (None, Hidden("payload", "j2", 0.3)))
    place = 1.7 * plain.body("link2").ipos
    moments = []
    for model in (plain, loaded):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        moments.append(data.subtree_com[0] * model.body_subtreemass[0])
        frame = data.body("link2").xmat.reshape(3, 3), data.body("link2").xpos
    assert moments[1] - moments[0] == pytest.approx(0.3 * (frame[0] @ place + frame[1]), abs=1e-9)


@pytest.mark.study
def test_scaled_effect_has_about_the_wanted_strength():
    robot = arm()
    hidden, found = scaled(robot, "damping", "j2", 5, SECONDS, 2.0)
    assert 1.2 < found < 3.0
    assert strength(record(robot, hidden, 5, SECONDS, step=COARSE), 5) == pytest.approx(found)


def test_a_stuck_joint_of_the_unit_does_not_creep():
    robot = cart_pole(np.random.default_rng(0))
    hidden = dosed(robot, "frictionloss", "slider", 4.0)
    model = unit_model(robot, hidden, 0, COARSE)
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.7 * model.dof_frictionloss[0]
    mujoco.mj_step(model, data, round(1.0 / COARSE))
    assert abs(data.qpos[0]) < 1e-6  # [m] in one second


def test_a_payload_adds_its_mass_and_its_moment_about_the_joint():
    robot = arm()
    hidden = dosed(robot, "payload", "j3", 2.0)
    models = [unit_model(robot, h, 0) for h in (None, hidden)]
    moments = []
    for model in models:
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        moments.append(float(np.abs(data.qfrc_bias).max()))
    assert models[1].body_mass.sum() - models[0].body_mass.sum() == pytest.approx(hidden.size)
    assert moments[1] > moments[0]


def test_commands_of_a_late_actuator_act_later_by_the_delay():
    robot = arm("position")
    late = replace(dosed(robot, "delay", "j3", 1.0), size=0.0235)
    log = record(robot, late, 5, SECONDS, step=COARSE)
    model = unit_model(robot, late, 5, COARSE)
    data = mujoco.MjData(model)
    rate = round(1.0 / (log.t[1] - log.t[0]))
    delays = np.where(model.actuator_trnid[:, 0] == 2, late.size, 0.0)
    steps = round(1.0 / (rate * COARSE))
    states = []
    for k in range(len(log.t) * steps):
        if k % steps == 0:
            states.append(np.concatenate([data.qpos, data.qvel]))
        sent = np.clip(np.floor(((k + 0.5) * COARSE - delays) * rate), 0, None).astype(int)
        data.ctrl[:] = log.commands[sent, np.arange(model.nu)]
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(log.states, states, atol=1e-9)


def test_written_log_is_read_back_with_names_and_units(tmp_path):
    log = record(arm("position"), None, 2, SECONDS, step=COARSE)
    path = log.write(tmp_path, "healthy")
    channels = [(n, u, "command" if n.startswith("m") else "measurement") for n, u in log.units.items()]
    recording = read_log(path, channels=channels)
    assert recording.names("command") == ("m1", "m2", "m3")
    assert recording.names("measurement") == log.names
    np.testing.assert_allclose(recording.channels["q_j2"].value, log.readings[:, 1], rtol=1e-6, atol=1e-9)
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "healthy.xml")).njnt == 3
