"""Which column of a log belongs to which joint of a model, by names, words and order."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import doubts_of, propose, survey_log
from deepkoco.logs.inspect.joints.log_joints import log_joints, role_in_name
from deepkoco.logs.inspect.joints.match import match_joints
from deepkoco.systems import load_system
from tests.logs.test_inspect_joints import Arm
from tests.logs.test_lerobot import write_v21


@pytest.mark.parametrize(
    ("log", "model"),
    [
        (
            ("rotation", "pitch", "elbow", "wrist_pitch", "wrist_roll", "jaw"),
            ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"),
        ),
        (("0", "1", "2"), ("hip", "knee", "ankle")),
        (("1", "2", "3"), ("hip", "knee", "ankle", "left_toe", "right_toe")),
        (("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint"), ("FL_hip", "FL_thigh", "FL_calf")),
    ],
)
def test_match_joints_by_name_and_order(log, model):
    assert [(m.log, m.model) for m in match_joints(log, model)] == [(k, k) for k in range(len(log))]


@settings(deadline=None)
@given(order=st.permutations(["elbow_flex", "shoulder_lift", "wrist_roll", "gripper"]))
def test_match_joints_prefers_equal_names_to_the_order(order):
    model = ["shoulder_lift", "elbow_flex", "wrist_roll", "gripper"]
    assert all(order[m.log] == model[m.model] for m in match_joints(order, model))


@pytest.mark.parametrize(
    ("log", "model", "pairs"),
    [
        (("4", "5", "6"), 6, [(0, 3), (1, 4), (2, 5)]),
        (("0", "2"), 4, [(0, 0), (1, 2)]),
        (("2", "1", "3"), 4, [(0, 1), (1, 0), (2, 2)]),
        (("11", "12"), 6, []),
    ],
)
def test_the_number_of_a_joint_is_its_place(log, model, pairs):
    found = match_joints(log, [f"link_{chr(97 + k)}" for k in range(model)])
    assert [(m.log, m.model) for m in found] == pairs
    assert all(m.probability < 0.9 for m in found)


def test_what_slides_is_no_joint_that_turns():
    found = match_joints(["1", "2"], ["slider", "hinge"], apart=[(0, 0), (1, 1)])
    assert [(m.log, m.model) for m in found] in ([], [(0, 1), (1, 0)])


def test_match_joints_leaves_strangers_out():
    assert [
        (m.log, m.model) for m in match_joints(["elbow", "camera_zoom"], ["wrist", "elbow", "shoulder"])
    ] == [(0, 1)]


@pytest.mark.parametrize(
    ("names", "joints"),
    [
        (["q_elbow", "dq_elbow", "goal_elbow", "load_elbow"], {"elbow": {"position", "speed", "goal", "effort"}}),
        (["observation.state[a.pos]", "action[a.pos]"], {"a": {"position", "goal"}}),
        (["dof_pos[0]", "des_dof_pos[0]", "dof_pos[1]"], {"0": {"position", "goal"}, "1": {"position"}}),
        (["position[arm_1]", "velocity[arm_1]", "effort[arm_1]"], {"arm_1": {"position", "speed", "effort"}}),
        (["interface_values[hip].values[position]", "interface_values[hip].values[effort]"],
         {"hip": {"position", "effort"}}),
        (["pos_meas1", "vel_meas1", "tau_con1"], {"1": {"position", "speed", "goal effort"}}),
    ],
)  # fmt: skip
def test_columns_are_grouped_by_joint(tmp_path, names, joints):
    t = 0.01 * np.arange(40)
    pd.DataFrame({"t": t, **{n: np.sin(t + k) for k, n in enumerate(names)}}).to_csv(
        tmp_path / "a.csv", index=False
    )
    found = log_joints(survey_log(open_log(tmp_path / "a.csv")).columns)
    assert {joint.label: set(joint.columns) for joint in found} == joints


@pytest.mark.parametrize(
    ("names", "joints"),
    [
        (
            ("X_Soll [mm]", "X_Ist [mm]", "X_Geschwindigkeit [mm/s]", "X_Kraft [N]"),
            {"x": {"goal", "position", "speed", "effort"}},
        ),
        # Words of other languages say nothing, units do.
        (("Z_pos [mm]", "Z_vitesse [mm/s]", "Z_effort_moteur [N]"), {"z": {"position", "speed"}}),
        (
            ("spalla_angolo [deg]", "spalla_coppia [Nm]", "gomito_angolo [deg]", "gomito_coppia [Nm]"),
            {"spalla": {"position", "effort"}, "gomito": {"position", "effort"}},
        ),
        # Two columns of one role are of two joints.
        (("arm_left [deg]", "arm_right [deg]"), {"arm_left": {"position"}, "arm_right": {"position"}}),
        (("hip [rad]", "hip_x [rad]"), {"hip": {"position"}, "hip_x": {"position"}}),
    ],
)
def test_units_join_the_columns_of_one_joint_where_words_do_not(tmp_path, names, joints):
    t = 0.01 * np.arange(40)
    pd.DataFrame({"t": t, **{n: np.sin(t + k) for k, n in enumerate(names)}}).to_csv(
        tmp_path / "a.csv", index=False
    )
    found = log_joints(survey_log(open_log(tmp_path / "a.csv")).columns, units=("rad", "m"))
    assert [(joint.label, set(joint.columns)) for joint in found] == [*joints.items()]


def test_a_joint_that_is_called_joint_1_is_found_by_that_name(tmp_path):
    names = ("joint_1 position [rad]", "torque_1 [Nm]", "joint_2 position [rad]", "torque_2 [Nm]")
    t = 0.01 * np.arange(40)
    pd.DataFrame({"t": t, **{n: np.sin(t + k) for k, n in enumerate(names)}}).to_csv(
        tmp_path / "a.csv", index=False
    )
    columns = survey_log(open_log(tmp_path / "a.csv")).columns
    found = log_joints(columns, ["joint_1", "joint_2"])
    assert [joint.label for joint in found] == ["joint_1", "joint_2"]
    assert all(set(joint.columns) == {"position", "effort"} for joint in found)
    # Another model counts its joints from 0, and calls none of them so.
    assert [joint.label for joint in log_joints(columns, ["axis_0", "axis_1"])] == ["1", "2"]


PAN_TILT = """<mujoco><compiler angle="radian"/><worldbody><body name="base" pos="0 0 0.1">
<joint name="pan" axis="0 0 1" damping="0.02"/><geom size="0.05" mass="0.4"/><body name="camera" pos="0 0 0.08">
<joint name="tilt" axis="0 1 0" damping="0.02"/><geom size="0.04" pos="0.03 0 0" mass="0.6"/></body></body></worldbody>
<actuator><velocity name="pan_rate" joint="pan" kv="0.6"/><velocity name="tilt_rate" joint="tilt" kv="0.8"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("suffix", ["_deg", " [rad]", ""])
def test_columns_that_are_called_as_joints_and_commands_of_speed_servos_are_mapped(tmp_path, suffix):
    t = 0.01 * np.arange(600)
    table = {"t": t, "cmd_pan": np.cos(2.0 * t), "cmd_tilt": np.cos(3.1 * t), "temperature": 30.0 + 0.1 * t}
    table |= {f"pan{suffix}": np.sin(2.0 * t), f"tilt{suffix}": 0.4 * np.sin(3.1 * t)}
    (tmp_path / "pan_tilt.xml").write_text(PAN_TILT)
    pd.DataFrame(table).to_csv(tmp_path / "log.csv", index=False)
    robot = load_system(str(tmp_path / "pan_tilt.xml"))
    proposal = propose(survey_log(open_log(tmp_path / "log.csv")), robot).proposal
    found = {c.channel.name: c.column.name for c in proposal.choices if c.column is not None}
    assert found == {
        "q_pan": f"pan{suffix}",
        "q_tilt": f"tilt{suffix}",
        "pan_rate": "cmd_pan",
        "tilt_rate": "cmd_tilt",
    }


def test_a_lerobot_dataset_is_mapped_by_the_names_of_its_joints(tmp_path):
    """Its third joint has no partner in the model."""
    dataset = write_v21(tmp_path / "mine")
    survey = survey_log(open_log(dataset / "episode_0"))
    choices = {c.channel.name: c for c in propose(survey, Arm()).proposal.choices}
    assert choices["q_shoulder_lift"].column.name == "observation.state[shoulder_lift.pos]"
    assert choices["shoulder_lift"].column.name == "action[shoulder_lift.pos]"
    assert choices["dq_shoulder_lift"].column is None


MACHINE = """
<mujoco><worldbody>
  <body name="arm"><joint name="first" axis="0 0 1" damping=".1"/>
    <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>
    <body name="fore" pos=".3 0 0"><joint name="second" axis="0 0 1" damping=".1"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .2 0 0"/></body></body></worldbody>
  <actuator>{}</actuator></mujoco>
"""


def machine(tmp_path, actuators: str, frame: pd.DataFrame):
    """Proposal for a log of a machine with two joints, and its doubts."""
    (tmp_path / "machine.xml").write_text(MACHINE.format(actuators))
    frame.to_csv(tmp_path / "log.csv", index=True)
    survey = survey_log(open_log(tmp_path / "log.csv"))
    proposal = propose(survey, str(tmp_path / "machine.xml")).proposal
    return {c.channel.name: c for c in proposal.choices}, doubts_of(survey, proposal), proposal


def swings(*names: str) -> dict[str, np.ndarray]:
    t = 0.01 * np.arange(600)
    return {name: np.sin((1.0 + 0.3 * k) * t) for k, name in enumerate(names)}


def test_efforts_without_joint_go_to_the_first_motors_with_the_unit_of_their_name(tmp_path):
    frame = pd.DataFrame({"t": 0.01 * np.arange(600), **swings("encoder0", "encoder1", "torque_mNm")})
    motors = '<motor name="m1" joint="first"/><motor name="m2" joint="second"/>'
    choices, _, proposal = machine(tmp_path, motors, frame)
    assert choices["m1"].column.name == "torque_mNm"
    assert (choices["m1"].unit, choices["m1"].sureness) == ("mN m", "a guess")
    assert choices["m2"].column is None
    assert proposal.time == "s"  # of t; the index that pandas writes is no clock
    assert all(joint.tracking is None for joint in proposal.joints)


def test_words_give_the_order_of_joints_where_columns_have_another(tmp_path):
    frame = pd.DataFrame(
        {"t": 0.01 * np.arange(600)}
        | swings("elbow_pos", "shoulder_pos", "elbow_vel_goal", "shoulder_vel_goal")
    )
    servos = '<velocity name="v1" joint="first" kv="1"/><velocity name="v2" joint="second" kv="1"/>'
    choices, _, _ = machine(tmp_path, servos, frame)
    assert choices["q_first"].column.name == "shoulder_pos"
    assert choices["v2"].column.name == "elbow_vel_goal"


def test_a_column_in_a_unit_that_its_command_does_not_have_is_a_doubt(tmp_path):
    frame = pd.DataFrame(
        {"t": 0.01 * np.arange(600)} | swings("q_first [rad]", "q_second [rad]", "tau_first [N m]")
    )
    motors = '<motor name="first" joint="first" gear="9"/><motor name="m2" joint="second"/>'
    _, doubts, _ = machine(tmp_path, motors, frame)
    assert any('"tau_first [N m]" is in N m, and first of' in doubt for doubt in doubts)


def test_columns_without_words_have_the_roles_of_their_units(tmp_path):
    frame = pd.DataFrame({"t": 0.01 * np.arange(600), **swings("M1[Nm]", "M2[Nm]", "A1[deg]", "A2[deg]")})
    motors = '<motor name="A1" joint="first"/><motor name="A2" joint="second"/>'
    choices, _, _ = machine(tmp_path, motors, frame)
    assert choices["q_first"].column.name == "A1[deg]"
    assert choices["q_second"].column.name == "A2[deg]"
    # An actuator is called as the angle is; an angle is no torque.
    assert choices["A1"].column.name == "M1[Nm]"
    assert choices["A2"].column.name == "M2[Nm]"


@pytest.mark.parametrize("name", ["angle_{}", "pos_{}"])
def test_numbers_at_the_end_of_names_are_those_of_joints(tmp_path, name):
    positions, torques = (name.format(1), name.format(2)), ("torque_1", "torque_2")
    frame = pd.DataFrame({"t": 0.01 * np.arange(600), **swings(*positions, *torques)})
    motors = '<motor name="m1" joint="first"/><motor name="m2" joint="second"/>'
    choices, _, _ = machine(tmp_path, motors, frame)
    found = {key: (c.column.name, c.unit) for key, c in choices.items() if c.column is not None}
    assert found == {
        "q_first": (positions[0], "rad"),
        "q_second": (positions[1], "rad"),
        "m1": ("torque_1", "N m"),
        "m2": ("torque_2", "N m"),
    }


MOTORS = '<motor name="m1" joint="first"/><motor name="m2" joint="second"/>'


def mapped(choices):
    return {key: c.column.name for key, c in choices.items() if c.column is not None}


@pytest.mark.parametrize("force", ["gripper_force[N]", "F_ext[N]"])
def test_a_sensor_of_forces_is_no_command_of_a_torque(tmp_path, force):
    angles = {"q_first": "q_first[rad]", "q_second": "q_second[rad]"}
    frame = pd.DataFrame({"t": 0.01 * np.arange(600), **swings(*angles.values(), force, "M1[Nm]")})
    choices, _, _ = machine(tmp_path, MOTORS, frame)
    assert mapped(choices) == {**angles, "m1": "M1[Nm]"}
    choices, _, _ = machine(tmp_path, MOTORS, frame.assign(**swings("M2[mNm]")))
    assert mapped(choices) == {**angles, "m1": "M1[Nm]", "m2": "M2[mNm]"}


@pytest.mark.parametrize(
    "others",
    [("tool_x[m]", "tool_z[m]"), ("gap [mm]",), ("pos_x[m]", "pos_y[m]"), ("camera[deg]",), ("pot_pos[V]",)],
)
def test_columns_that_are_in_the_unit_of_a_position_are_no_joints_beside_those_of_the_model(tmp_path, others):
    words = ("theta1", "theta2", "u1[Nm]", "u2[Nm]")
    frame = pd.DataFrame({"t": 0.01 * np.arange(600), **swings(*others, *words)})
    choices, _, _ = machine(tmp_path, MOTORS, frame)
    assert mapped(choices) == dict(zip(("q_first", "q_second", "m1", "m2"), words, strict=True))


GRIPPER_ARM = """<mujoco model="picker">
  <worldbody>
    <body><joint name="waist" axis="0 0 1"/><geom size="0.05"/>
      <body><joint name="elbow" axis="0 1 0"/><geom size="0.05" pos="0.2 0 0"/>
        <body pos="0.3 0 0"><joint name="finger" type="slide"/><geom size="0.02"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="waist" kp="20" ctrlrange="-2 2"/>
    <position joint="elbow" kp="20" ctrlrange="-2 2"/>
    <position joint="finger" kp="20" ctrlrange="0 0.1"/>
  </actuator>
</mujoco>"""


def write_picks(path):
    """A log of numbered joints without the finger, beside the pose of a box that no joint moves."""
    t = 0.05 * np.arange(400)
    goals = [0.5 * np.sin(1.1 * t), 0.4 * np.sin(0.7 * t + 1.0)]
    columns = {f"jpos{k}_rad": np.interp(t - 0.1, t, goal) for k, goal in enumerate(goals)}
    columns |= {f"jpos_target{k}_rad": goal for k, goal in enumerate(goals)}
    pd.DataFrame({"time_s": t, **columns, "box_x_m": 0.3 + 0.1 * np.sin(0.3 * t)}).to_csv(path, index=False)


def test_numbered_joints_of_an_arm_leave_its_fingers_out(tmp_path):
    (tmp_path / "picker.xml").write_text(GRIPPER_ARM)
    write_picks(tmp_path / "a.csv")
    survey = survey_log(open_log(tmp_path / "a.csv"))
    fitting = propose(survey, load_system(tmp_path / "picker.xml"))
    columns = {c.channel.name: c.column.name for c in fitting.proposal.choices if c.column is not None}
    assert {k: v for k, v in columns.items() if k.startswith("q_")} == {
        "q_waist": "jpos0_rad",
        "q_elbow": "jpos1_rad",
    }
    assert fitting.doubt is not None
    assert (
        'if finger stood still, write held: ["finger"] into picker.parameters.yaml beside picker.xml'
        in fitting.doubt
    )


def test_poses_of_other_things_are_no_doubt_of_an_arm_that_follows_its_goals(tmp_path):
    (tmp_path / "picker.xml").write_text(GRIPPER_ARM)
    (tmp_path / "picker.parameters.yaml").write_text('held: ["finger"]')
    write_picks(tmp_path / "a.csv")
    fitting = propose(survey_log(open_log(tmp_path / "a.csv")), load_system(tmp_path / "picker.xml"))
    assert fitting.doubt is None
    assert all(
        choice.column.name != "box_x_m" for choice in fitting.proposal.choices if choice.column is not None
    )


@pytest.mark.parametrize("name", ["{}_cmd", "{}_setpoint", "u_{}", "{} command", "ctrl_{}"])
def test_the_name_of_an_actuator_may_stand_beside_a_word_for_a_goal(tmp_path, name):
    motors = '<motor name="drive" joint="first" gear="10"/><motor name="m_b" joint="second" gear="4"/>'
    wanted = {"drive": name.format("drive"), "m_b": name.format("m_b")}
    moving = swings("first_pos_rad", "second_pos_rad", *wanted.values())
    choices, _, _ = machine(tmp_path, motors, pd.DataFrame({"t": 0.01 * np.arange(600), **moving}))
    assert {motor: choices[motor].column.name for motor in wanted} == wanted


@pytest.mark.parametrize("name", ["second_speed [rpm]", "dq_second", "second_velocity [rad/s]"])
def test_a_joint_may_have_a_speed_alone(tmp_path, name):
    motors = '<motor name="m1" joint="first"/><motor name="m2" joint="second"/>'
    moving = swings("first_pos_rad", name, "m1_cmd", "m2_cmd")
    choices, _, _ = machine(tmp_path, motors, pd.DataFrame({"t": 0.01 * np.arange(600), **moving}))
    assert choices["dq_second"].column.name == name
    assert choices["dq_second"].unit == ("rpm" if "rpm" in name else "rad/s")
    assert choices["q_second"].column is None
    assert choices["dq_first"].column is None


@pytest.mark.parametrize(
    ("name", "role", "label"),
    [
        ("pan_current_cmd_mA", "goal effort", "pan"),
        ("pan_current_A", "effort", "pan"),
        ("motor_x_A", None, "x"),  # of a motor; "pos" and "current" would say more
        ("motor_A", None, "a"),
        ("i_pan_A", None, "i_pan"),
        ("motor_pan_V", None, "pan"),
        ("motor_pan_pos_A", "position", "pan_a"),
        ("current_A", "effort", "a"),  # of a joint A: no other word says a joint
        ("pos_A", "position", "a"),
        ("wrist_pos_s", "position", "wrist_s"),  # no position is in seconds
        ("elbow_torque_mNm", "effort", "elbow"),
        ("lift_vel_mm_s", "speed", "lift"),
        ("shoulder_pos_deg", "position", "shoulder"),
    ],
)
def test_the_unit_at_the_end_of_a_name_is_no_part_of_the_joint(name, role, label):
    assert role_in_name(name) == (role, label)


CART = """
<mujoco model="cart"><worldbody><body><joint name="rail" type="slide" axis="1 0 0"/><geom size=".1" mass="2"/>
  <body><joint name="pole" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.5" mass="1"/></body></body>
</worldbody><actuator><motor name="rail_motor" joint="rail"/><motor name="pole_motor" joint="pole"/></actuator></mujoco>
"""


def test_the_name_of_an_actuator_with_its_unit_is_its_name(tmp_path):
    (tmp_path / "cart.xml").write_text(CART)
    t = np.arange(0.0, 4.0, 0.01)
    columns = {
        "rail_mm": 90.0 * np.sin(t),
        "pole_deg": 20.0 * np.cos(2.0 * t),
        "pole_motor_Nm": np.sin(3.0 * t),
    }
    # The letter N may count joints; here it is the unit of the force that the actuator takes.
    frame = pd.DataFrame({"t": t, **columns, "rail_motor_N": 5.0 * np.cos(3.3 * t)})
    frame.to_csv(tmp_path / "log.csv", index=False)
    proposal = propose(
        survey_log(open_log(tmp_path / "log.csv")), load_system(tmp_path / "cart.xml")
    ).proposal
    found = {c.channel.name: (c.column and c.column.name, c.unit, c.sureness) for c in proposal.choices}
    assert found["rail_motor"] == ("rail_motor_N", "N", "sure")
    assert found["pole_motor"] == ("pole_motor_Nm", "N m", "sure")
    assert found["q_rail"] == ("rail_mm", "mm", "sure")
