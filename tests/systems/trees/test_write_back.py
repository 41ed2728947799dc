"""Robots written back as MJCF: plain MuJoCo must move as the extended system does."""

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.simulate.simulator import trajectories
from deepkoco.systems import ExtendedSystem, load_system
from deepkoco.systems.trees import TreeError, TreeSystem
from deepkoco.systems.trees.robot_files import write_robot
from deepkoco.systems.trees.write_back import extended_mjcf
from tests.studied import studied

ARM = """
<mujoco model="arm">
  <compiler angle="degree"/>
  <option timestep="0.001"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.02" stiffness="1" springref="10"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
      <body name="fore" pos="0.3 0 0">
        <joint name="elbow" axis="0.6 0.8 0" damping="0.2" armature="0.02"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.5"/>
        <body name="hand" pos="0.25 0 0">
          <geom type="sphere" size="0.03" mass="0.2"/>
          <site name="grip" pos="0.05 0.01 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="lift" joint="shoulder" ctrlrange="-10 10"/>
    <position name="bend" joint="elbow" kp="12" kv="0.4" forcerange="-9 9" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""
URDF = """
<robot name="two">
  <link name="base"/>
  <link name="arm"><inertial><origin xyz="0.1 0 0"/><mass value="0.5"/>
    <inertia ixx="0.001" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="5" velocity="3"/><dynamics damping="0.1" friction="0.02"/></joint>
</robot>
"""
SECONDS, STEP, HOLD = 1.0, 5e-3, 0.05
EXPRESSED = {
    "mass(fore)": ((), {"mass(fore)": 0.9}),
    "com_x(fore)": ((), {"com_x(fore)": 0.2}),
    "inertia_y(fore)": ((), {"inertia_y(fore)": 0.012}),
    "kp(bend)": ((), {"kp(bend)": 17.0}),
    "kv(bend)": ((), {"kv(bend)": 0.8}),
    "force_limit(bend)": ((), {"force_limit(bend)": 1.2}),
    "gain(lift)": ((), {"gain(lift)": 0.8}),
    "springref(shoulder)": ((), {"springref(shoulder)": 0.5}),
    "armature(elbow)": ((), {"armature(elbow)": 0.05}),
    "viscous": (("viscous(elbow)",), {"viscous(elbow).change": 0.2}),
    "coulomb": (("coulomb(elbow)",), {"coulomb(elbow).torque": 0.3}),
    "quadratic": (("quadratic(shoulder)",), {"quadratic(shoulder).drag": 0.2}),
    "payload": (("payload",), {"payload.mass": 0.4}),
    "gain": (("gain(shoulder)",), {"gain(shoulder).factor": 0.7}),
    "gain of a servo": (("gain(elbow)",), {"gain(elbow).factor": 0.7}),
    "strength of a servo": (("drive_strength(elbow)",), {"drive_strength(elbow).factor": 0.7}),
    "bias": (("torque_bias(shoulder)",), {"torque_bias(shoulder).effort": 0.5}),
    "bias of a servo": (("torque_bias(elbow)",), {"torque_bias(elbow).effort": 0.2}),
    "gain and bias": (
        ("gain(elbow)", "torque_bias(elbow)"),
        {"gain(elbow).factor": 0.8, "torque_bias(elbow).effort": 0.2},
    ),
    "saturation": (("saturation(shoulder)",), {"saturation(shoulder).limit": 1.0}),
    "gain, bias and saturation": (
        ("gain(shoulder)", "torque_bias(shoulder)", "saturation(shoulder)"),
        {
            "gain(shoulder).factor": 1.2,
            "torque_bias(shoulder).effort": 0.3,
            "saturation(shoulder).limit": 1.5,
        },
    ),
    "lag": (("lag(shoulder)",), {"lag(shoulder).time_constant": 0.05}),
    "delay": (("actuation_delay(elbow)",), {"actuation_delay(elbow).delay": 0.0345}),
    "tilt": (("tilt",), {"tilt.about_x": 0.2}),
    "spring": (("spring(elbow)",), {"spring(elbow).stiffness": 2.0, "spring(elbow).centre": 0.3}),
    "gain of all": (("gain(all)",), {"gain(all).factor": 0.8}),
    "delay of all": (("actuation_delay(all)",), {"actuation_delay(all).delay": 0.0345}),
    "payload at a place": (("payload(upper)",), {"payload(upper).mass": 0.4}),
    "payload along a link": (("payload(upper)",), {"payload(upper).mass": 0.4, "payload(upper).along": 0.28}),
    "mass of a body": (("body_mass(upper)",), {"body_mass(upper).factor": 1.6}),
    "factor of all": (("scaled(damping)",), {"scaled(damping).factor": 2.0}),
}


def held_commands() -> np.ndarray:
    """(n, 2) commands, held for HOLD seconds each; the first is zero."""
    rng = np.random.default_rng(3)
    commands = rng.uniform(-1.0, 1.0, (round(SECONDS / HOLD), 2)) * [3.0, 1.2]
    commands[0] = 0.0  # filters and delays of both simulations then begin alike
    return commands


def simulated(system) -> np.ndarray:
    """(n + 1, J) joint angles of the package's own simulation, from rest at zero."""
    commands = held_commands()[:, : len(system.commands)]
    t = HOLD * np.arange(len(commands))
    steps = round(SECONDS / STEP)
    none = torch.zeros(1, 1, 0)
    windows = Windows(
        (CommandSeries(t, commands if commands.shape[1] > 1 else commands[:, 0]),),
        np.zeros(1, dtype=int), np.zeros(1), STEP, steps, none, none, none.bool(), (), none, np.zeros(1, dtype=bool),
    )  # fmt: skip
    values = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in system.parameters}
    start = torch.zeros(1, 1, 2 * system.joints, dtype=torch.float64)
    states, _, _ = trajectories(system, windows, values, start)
    return states[:, 0, 0, : system.joints].numpy()


def rolled_out(xml: str, joints: int) -> np.ndarray:
    """The same motion in plain MuJoCo."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.timestep, model.opt.integrator = 2e-4, mujoco.mjtIntegrator.mjINT_RK4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    every = round(STEP / model.opt.timestep)
    if model.actuator_delay.any():
        # The buffer holds samples of the file's own time step.
        model.opt.timestep = 1e-3
        every = 5
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    commands = held_commands()[:, : model.nu]
    result = [data.qpos[:joints].copy()]
    for k in range(round(SECONDS / STEP)):
        for i in range(every):
            data.ctrl[:] = commands[
                min(int((k * STEP + i * model.opt.timestep) / HOLD + 1e-6), len(commands) - 1)
            ]
            mujoco.mj_step(model, data)
        result.append(data.qpos[:joints].copy())
    return np.array(result)


@pytest.fixture
def arm(tmp_path) -> TreeSystem:
    """An arm of two joints, with a motor and a position servo."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return load_system(path)


@pytest.mark.parametrize("case", EXPRESSED)
def test_plain_mujoco_moves_as_the_extended_robot(arm, case):
    effects, values = EXPRESSED[case]
    system = ExtendedSystem(arm, effects, values)
    written = extended_mjcf(system)
    assert written.left_out == []
    assert written.changes
    ours, theirs, given = simulated(system), rolled_out(written.xml, 2), simulated(arm)
    effect = np.sqrt(np.mean((ours - given) ** 2))
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 0.02 * effect
    assert effect > 1e-3


SHAPED = {
    "length(fore)": 0.36,
    "axis_x(elbow)": 0.2,
    "axis_z(elbow)": -0.2,
    "axis_z(shoulder)": 0.15,
    "zero(elbow)": 0.3,
    "inertia_xy(fore)": 1e-3,
}


@pytest.mark.parametrize("name", studied(SHAPED, ("length(fore)", "axis_x(elbow)", "inertia_xy(fore)")))
def test_plain_mujoco_moves_as_the_robot_with_another_shape(tmp_path, name):
    # A plate between the links, without a joint and with axes of its own, is no obstacle.
    plate = '<body name="plate" pos="0.05 0 0.02" euler="0 30 20"><body name="fore" pos="0.25 0 0"'
    text = ARM.replace('<body name="fore" pos="0.3 0 0"', plate).replace('size="0.02"', 'size="0.1"')
    text = text.replace("</worldbody>", "</body></worldbody>")
    (tmp_path / "arm.xml").write_text(text)
    (tmp_path / "arm.parameters.yaml").write_text(f"parameters: {{{name}: {{prior_sd: 0.01}}}}")
    given = load_system(tmp_path / "arm.xml")
    system = ExtendedSystem(given, (), {name: SHAPED[name]})
    written = extended_mjcf(system)
    assert written.left_out == []
    assert written.changes
    # What the shape changes in each simulation: their own small errors cancel.
    ours, theirs = simulated(system) - simulated(given), rolled_out(written.xml, 2) - rolled_out(text, 2)
    effect = np.sqrt(np.mean(ours**2))
    assert effect > 1e-3
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 0.02 * effect


def test_a_heavier_body_is_held_up_by_what_held_up_the_given_one(tmp_path):
    text = ARM.replace('<body name="fore"', '<body name="fore" gravcomp="0.5"')
    (tmp_path / "arm.xml").write_text(text)
    given = load_system(tmp_path / "arm.xml")
    system = ExtendedSystem(given, (), {"mass(upper)": 1.4, "mass(fore)": 0.9})
    written = extended_mjcf(system)
    ours, theirs, before = simulated(system), rolled_out(written.xml, 2), simulated(given)
    effect = np.sqrt(np.mean((ours - before) ** 2))
    assert [c.attribute for c in written.changes] == ["mass", "mass", "gravcomp"]
    # The hand is part of the fore arm here, and only the fore arm was held up, at a centre of its own.
    assert "gravity compensation of fore" in written.left_out[0]
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 0.1 * effect


def test_actuators_of_one_joint_are_written_each_to_its_own(tmp_path):
    second = '<motor name="lift" joint="shoulder" ctrlrange="-10 10"/><motor name="help" joint="shoulder" gear="2"/>'
    text = ARM.replace('<motor name="lift" joint="shoulder" ctrlrange="-10 10"/>', second)
    (tmp_path / "arm.xml").write_text(text)
    robot = load_system(tmp_path / "arm.xml")
    system = ExtendedSystem(robot, (), {"kp(bend)": 17.0, "gain(help)": 0.5})
    model = mujoco.MjModel.from_xml_string(extended_mjcf(system).xml)
    assert model.actuator("bend").gainprm[0] == pytest.approx(17.0)
    assert model.actuator("help").gainprm[0] == pytest.approx(0.5)
    assert model.actuator("lift").gainprm[0] == 1.0


def test_servos_and_values_from_the_settings_are_in_the_file(tmp_path):
    text = ARM[: ARM.index("  <actuator>")] + "</mujoco>"
    (tmp_path / "arm.xml").write_text(text)
    (tmp_path / "arm.parameters.yaml").write_text(
        'parameters: {"frictionloss(*)": 0.05}\nservos: {"*": {kp: 20, kv: 0.5, force: 9}}\n'
    )
    system = load_system(tmp_path / "arm.xml")
    written = extended_mjcf(system)
    model = mujoco.MjModel.from_xml_string(written.xml)
    np.testing.assert_allclose(model.dof_frictionloss, 0.05)
    np.testing.assert_allclose(model.actuator_forcerange, [[-9, 9]] * 2)
    ours, theirs = simulated(system), rolled_out(written.xml, 2)
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 0.01 * np.sqrt(np.mean(ours**2))


def test_an_outside_force_is_named_with_the_numbers_to_set(arm):
    system = ExtendedSystem(arm, ("force(fore)",), {"force(fore).z": 1.5})
    assert "data.body('fore').xfrc_applied[:3] = [0, 0, 1.5]" in extended_mjcf(system).left_out[0]


def test_friction_that_differs_between_directions_moves_plain_mujoco_as_said(arm, monkeypatch):
    system = ExtendedSystem(
        arm, ("asymmetric_viscous(shoulder)",), {"asymmetric_viscous(shoulder).difference": 0.8}
    )
    written = extended_mjcf(system)
    said = "data.joint('shoulder').qfrc_applied = -0.4 * abs(data.joint('shoulder').qvel)"
    assert said in written.left_out[0]
    ours, given = simulated(system), rolled_out(written.xml, 2)
    step = mujoco.mj_step

    def as_said(model, data):
        data.joint("shoulder").qfrc_applied = -0.4 * abs(data.joint("shoulder").qvel)
        step(model, data)

    monkeypatch.setattr(mujoco, "mj_step", as_said)
    scale = np.sqrt(np.mean(ours**2))
    assert np.sqrt(np.mean((ours - rolled_out(written.xml, 2)) ** 2)) < 0.01 * scale
    assert np.sqrt(np.mean((ours - given) ** 2)) > 0.05 * scale


def test_a_robot_without_effects_is_written_as_it_was_given(arm):
    written = extended_mjcf(arm)
    assert written.changes == []
    assert written.left_out == []
    given, back = mujoco.MjModel.from_xml_string(ARM), mujoco.MjModel.from_xml_string(written.xml)
    for name in ("body_mass", "body_inertia", "dof_damping", "actuator_gainprm", "qpos_spring", "site_pos"):
        np.testing.assert_allclose(getattr(back, name), getattr(given, name), rtol=1e-5, atol=1e-9)


def test_effects_that_mjcf_cannot_hold_are_named_with_a_way_out(arm):
    names = ("dead_zone(elbow)", "sensor_bias(elbow)")
    plain = ExtendedSystem(arm, names)
    own = [p for p in plain.parameters if p.name.startswith(names)]
    system = ExtendedSystem(arm, names, {p.name: 0.01 for p in own})
    written = extended_mjcf(system)
    assert [text.split(":")[0] for text in written.left_out] == list(names)
    assert written.changes == []


def test_less_friction_than_none_is_written_as_none_and_said(arm):
    system = ExtendedSystem(arm, ("viscous(elbow)",), {"viscous(elbow).change": -0.5})
    written = extended_mjcf(system)
    assert "no negative damping" in written.left_out[0]
    assert mujoco.MjModel.from_xml_string(written.xml).dof_damping[1] == 0.0


def test_a_urdf_robot_becomes_mjcf_with_a_motor_for_each_joint(tmp_path):
    path = tmp_path / "two.urdf"
    path.write_text(URDF)
    robot = load_system(path)
    system = ExtendedSystem(robot, ("coulomb",), {"coulomb.torque": 0.05})
    written = extended_mjcf(system)
    model = mujoco.MjModel.from_xml_string(written.xml)
    assert model.nu == 1
    assert model.dof_frictionloss[0] == pytest.approx(0.07)
    ours, theirs = simulated(system), rolled_out(written.xml, 1)
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 0.01 * np.sqrt(np.mean(ours**2))


def test_the_written_robot_loads_again_with_the_new_values(arm, tmp_path):
    system = ExtendedSystem(
        arm,
        ("coulomb(elbow)", "lag(shoulder)", "actuation_delay(elbow)"),
        {
            "coulomb(elbow).torque": 0.2,
            "lag(shoulder).time_constant": 0.03,
            "actuation_delay(elbow).delay": 0.0345,
        },
    )
    (tmp_path / "out").mkdir()
    file, text = write_robot(system, tmp_path / "out")
    again = load_system(file)
    assert again.parameter("frictionloss(elbow)").value == pytest.approx(0.2)
    assert again.parameter("time_constant(lift)").value == pytest.approx(0.03)
    assert again.parameter("delay(bend)").value == pytest.approx(0.0345)
    assert "coulomb(elbow)" in text.read_text()
    assert "fitted together" not in text.read_text()
    assert 'MuJoCo\'s integrator "euler" is of first order' in text.read_text()
    with pytest.raises(FileExistsError):
        write_robot(system, tmp_path / "out")


def test_what_was_found_stands_above_what_was_fitted_with_it(arm, tmp_path):
    system = ExtendedSystem(arm, ("coulomb(elbow)",), {"coulomb(elbow).torque": 0.2, "damping(elbow)": 0.201})
    _, text = write_robot(system, tmp_path)
    lines = text.read_text().splitlines()
    rows = [
        next(k for k, line in enumerate(lines) if word in line)
        for word in ("frictionloss", "fitted together", "damping")
    ]
    assert rows == sorted(rows)


def test_a_system_that_came_from_no_file_is_refused():
    with pytest.raises(TreeError, match="was not read from an MJCF or URDF file"):
        extended_mjcf(load_system("rod_pendulum"))
