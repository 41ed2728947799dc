"""Mapping of logs of many joints: names, units, directions and zeros against a model."""

import json

import numpy as np
import pandas as pd
import pytest
import torch
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from deepkoco.cli.command_line import main
from deepkoco.logs import read_log
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import doubts_of, mapping_of, propose, survey_log
from deepkoco.logs.inspect.joints.finding import from_ranges
from deepkoco.logs.inspect.joints.goals import track
from deepkoco.logs.inspect.joints.gravity import Slow, signs_and_zeros
from deepkoco.logs.inspect.joints.log_joints import log_joints
from deepkoco.logs.inspect.joints.match import match_joints
from deepkoco.logs.sidecar import dump_sidecar
from deepkoco.systems import SYSTEMS, Channel, Motion, Parameter, System, load_system
from tests.logs.test_lerobot import write_v21

WEIGHT = (3.0, 1.2)  # gravity on the two links, horizontal [N m]


class Arm(System):
    """Two links in a vertical plane behind position servos; at angle 0 both are horizontal, or hang if `hanging`.

    The coupling of the inertias is left out: gravity and servos make the evidence.
    """

    name = "test_arm"
    joints = 2
    joint_names = ("shoulder_lift", "elbow_flex")
    state_names = ("q_shoulder_lift", "q_elbow_flex", "dq_shoulder_lift", "dq_elbow_flex")
    state_units = ("rad", "rad", "rad/s", "rad/s")
    load_scale = 3.0
    phase = 0.0

    def __init__(self) -> None:
        self.parameters = (Parameter("stiffness", 40.0, "N m/rad", 1.0, 100.0, 10.0, "k"),)
        kinds = (("q", "rad"), ("dq", "rad/s"))
        noise = {"q": 1e-3, "dq": 0.05}
        self.measurements = tuple(
            Channel(f"{k}_{j}", unit, "measurement", noise_sd=noise[k])
            for k, unit in kinds
            for j in self.joint_names
        )

    @property
    def commands(self) -> tuple[Channel, ...]:
        return tuple(Channel(j, "rad", "command", -1.8, 1.8) for j in self.joint_names)

    def gravity(self, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
        far = WEIGHT[1] * torch.cos(first + second + self.phase)
        return -WEIGHT[0] * torch.cos(first + self.phase) - far, -far

    def accelerations(self, parameters):
        def law(motion: Motion) -> tuple[Tensor, ...]:
            pulls = self.gravity(*motion.angles)
            loads = motion.loads or (None, None)
            return tuple(
                (g + parameters["stiffness"] * (u - q) - 0.5 * v + (0.0 if w is None else w)) / 0.1
                for g, u, q, v, w in zip(
                    pulls, motion.efforts, motion.angles, motion.speeds, loads, strict=True
                )
            )

        return law

    def derivative(self, state, effort, parameters):
        raise NotImplementedError

    def with_payload(self, mass, parameters):
        raise NotImplementedError

    def draw_on(self, image, measurement, command=None):
        raise NotImplementedError


class HangingArm(Arm):
    name = "hanging_arm"
    phase = -np.pi / 2


def moved(arm: Arm, seed: int = 0, noise: float = 2e-3) -> dict[str, np.ndarray]:
    """Goals that go from pose to pose with rests of 2 s, and positions that sag under them."""
    rng = np.random.default_rng(seed)
    poses = np.repeat(rng.uniform(-1.2, 1.2, size=(16, 2)), 2, axis=0)
    t = 0.02 * np.arange(50 * 2 * (len(poses) - 1))
    goal = np.stack([np.interp(t, 2.0 * np.arange(len(poses)), poses[:, j]) for j in range(2)], axis=1)
    q = goal.copy()
    for _ in range(60):  # the pose at which servo and gravity are in balance
        pull = arm.gravity(torch.from_numpy(q[:, 0]), torch.from_numpy(q[:, 1]))
        q = goal + np.stack([p.numpy() for p in pull], axis=1) / 40.0
    return {"t": t, "goal": goal, "q": q + noise * rng.normal(size=q.shape)}


def write(path, motion, signs=(1, 1), zeros=(0.0, 0.0), names=("pitch", "elbow"), unit="rad", goal_sign=1):
    """Write a log in a frame of its own: model = sign log + zero."""
    columns = {"t": motion["t"]}
    factor = {"rad": 1.0, "deg": 180.0 / np.pi, "ticks": 4096 / (2 * np.pi)}[unit]
    for k, name in enumerate(names):
        q, goal = (signs[k] * (motion[key][:, k] - zeros[k]) for key in ("q", "goal"))
        middle = 2048 if unit == "ticks" else 0
        columns[f"q_{name}"] = factor * q + middle
        columns[f"goal_{name}"] = goal_sign * factor * goal + middle
        columns[f"dq_{name}"] = np.gradient(q, motion["t"])
    frame = pd.DataFrame(columns)
    if unit == "ticks":
        frame = frame.round({c: 0 for c in frame if c[0] in "qg"})
    frame.to_csv(path, index=False)
    return path


def findings(path, system):
    fitting = propose(survey_log(open_log(path)), system)
    return fitting, {joint.model: joint for joint in fitting.proposal.joints}


@pytest.mark.parametrize(
    ("log", "model"),
    [
        (
            ("rotation", "pitch", "elbow", "wrist_pitch", "wrist_roll", "jaw"),
            ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"),
        ),
        (("0", "1", "2"), ("hip", "knee", "ankle")),
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


@settings(
    deadline=None,
    max_examples=8,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(signs=st.tuples(st.sampled_from((1, -1)), st.sampled_from((1, -1))), seed=st.integers(0, 5))
def test_directions_are_found_from_the_sag(tmp_path, signs, seed):
    path = tmp_path / f"log_{signs[0]}_{signs[1]}_{seed}.csv"
    write(path, moved(Arm(), seed), signs)
    _, found = findings(path, Arm())
    assert tuple(joint.sign for joint in found.values()) == signs
    assert all(joint.sign_known for joint in found.values())


def test_a_shifted_zero_is_found_from_the_sag(tmp_path):
    zero = 0.5
    path = write(tmp_path / "a.csv", moved(Arm()), zeros=(zero, 0.0))
    found = findings(path, Arm())[1]["shoulder_lift"]
    assert found.zero == pytest.approx(zero, abs=0.13)
    assert found.zero_known


def test_an_arm_that_hangs_at_zero_shows_no_directions(tmp_path):
    """Its mirror image behaves alike, so that nothing but a guess is possible."""
    path = write(tmp_path / "a.csv", moved(HangingArm()), signs=(-1, -1))
    _, found = findings(path, HangingArm())
    assert not any(joint.sign_known or joint.zero_known for joint in found.values())
    assert all(joint.why_sign.startswith("assumed") for joint in found.values())


def test_one_pose_shows_nothing(tmp_path):
    motion = moved(Arm())
    still = {
        **motion,
        "q": motion["q"][:1] + 0.0 * motion["q"],
        "goal": motion["goal"][:1] + 0.0 * motion["goal"],
    }
    still["q"] = still["q"] + 1e-4 * np.random.default_rng(0).normal(size=still["q"].shape)
    _, found = findings(write(tmp_path / "a.csv", still), Arm())
    assert not any(joint.sign_known for joint in found.values())


@settings(
    deadline=None,
    max_examples=12,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    signs=st.tuples(st.sampled_from((1, -1)), st.sampled_from((1, -1))),
    unit=st.sampled_from(("rad", "deg", "ticks")),
    goal_sign=st.sampled_from((1, -1)),
)
def test_the_proposed_sidecar_gives_the_motion_of_the_model(tmp_path, signs, unit, goal_sign):
    """Written with direction, unit and direction of the goal changed, read back by the sidecar as it is."""
    if unit == "ticks":
        goal_sign = 1
    motion = moved(Arm(), 1)
    path = tmp_path / f"{signs[0]}{signs[1]}{unit}{goal_sign}.csv"
    write(path, motion, signs, unit=unit, goal_sign=goal_sign)
    survey = survey_log(open_log(path))
    proposal = propose(survey, Arm()).proposal
    content = yaml.safe_load(dump_sidecar(Arm.name, mapping_of(survey, proposal), {}))
    arm = Arm()
    channels = [(c.name, c.unit, c.kind) for c in (*arm.commands, *arm.measurements)]
    recording = read_log(path, content, channels=channels)
    tick = 2 * np.pi / 4096
    for k, joint in enumerate(arm.joint_names):
        np.testing.assert_allclose(recording.channels[f"q_{joint}"].value, motion["q"][:, k], atol=tick)
        np.testing.assert_allclose(recording.channels[joint].value, motion["goal"][:, k], atol=tick)
        np.testing.assert_allclose(
            recording.channels[f"dq_{joint}"].value, np.gradient(motion["q"][:, k], motion["t"]), atol=1e-9
        )


def test_signs_need_enough_poses_and_a_model_with_gravity():
    q = np.tile(np.linspace(0, 1, 200)[:, None], (1, 2))
    few = Slow(0.0 * q, 0.0 * q, 0.01 * q, 60.0)
    assert signs_and_zeros(Arm(), few, [True, True]) is None


@given(
    delay=st.sampled_from((0.0, 0.05, 0.2)), slope=st.sampled_from((1.0, -1.0, 0.8)), zero=st.floats(-2, 2)
)
def test_track_finds_delay_slope_and_zero(delay, slope, zero):
    t = 0.01 * np.arange(1000)
    goal = np.sin(0.9 * t) + 0.4 * np.sin(2.3 * t + 1.0)
    position = zero + slope * (np.sin(0.9 * (t - delay)) + 0.4 * np.sin(2.3 * (t - delay) + 1.0))
    found = track(t, position, t, goal)
    assert found is not None
    assert found.follows
    assert found.slope == pytest.approx(slope, abs=0.03)
    assert found.offset == pytest.approx(zero, abs=0.03)
    assert found.delay == pytest.approx(delay, abs=0.021)


def test_track_does_not_take_a_fast_goal_for_a_reversed_one():
    t = 0.02 * np.arange(600)
    goal = np.sin(2 * np.pi * 1.6 * t)
    found = track(t, 0.9 * np.sin(2 * np.pi * 1.6 * (t - 0.05)), t, goal)
    assert found is not None
    assert found.slope > 0


@pytest.mark.parametrize(
    ("span", "expected"),
    [
        ((-0.5, 0.9), None),  # fits as it is
        ((-1.5, 0.1), (-1, 0.0)),
        ((3.0, 4.0), (1, -np.pi)),
        ((-3.0, 3.0), None),  # fits in no way
    ],
)
def test_from_ranges_proposes_only_what_the_range_needs(span, expected):
    found = from_ranges(-0.6, 1.6, *span, True)
    if expected is None:
        assert found is None
    else:
        assert found is not None
        assert found[0] == expected[0]
        assert found[1] == pytest.approx(expected[1])


def test_inspect_writes_a_sidecar_that_says_what_is_not_known(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(SYSTEMS, Arm.name, Arm)
    logs = tmp_path / "logs"
    logs.mkdir()
    for k in range(3):
        write(logs / f"run{k}.csv", moved(Arm(), k), signs=(1, -1))
    out = tmp_path / "logs.yaml"
    assert main(["inspect", str(logs), "--system", Arm.name, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "the first of 3 recordings" in text
    content = yaml.safe_load(out.read_text())
    assert content["channels"]["q_elbow_flex"]["scale"] == -1.0
    assert content["channels"]["elbow_flex"]["scale"] == -1.0
    assert "scale" not in content["channels"]["q_shoulder_lift"]
    assert "sign not known" not in content["meta"]
    recording = read_log(logs / "run2.csv")  # by the sidecar of the folder
    np.testing.assert_allclose(
        recording.channels["q_elbow_flex"].value, moved(Arm(), 2)["q"][:, 1], atol=1e-9
    )
    assert main(["inspect", str(logs), "--system", Arm.name, "--json"]) == 0
    described = json.loads(capsys.readouterr().out)
    assert [joint["sign"] for joint in described["proposal"]["joints"]] == [1, -1]


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
