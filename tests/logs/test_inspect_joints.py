"""Units, directions and zeros of the joints of a log against a model."""

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
from deepkoco.logs.inspect import mapping_of, propose, survey_log
from deepkoco.logs.inspect.joints.finding import from_ranges
from deepkoco.logs.inspect.joints.goals import track
from deepkoco.logs.inspect.joints.gravity import Slow, signs_and_zeros
from deepkoco.logs.sidecar import dump_sidecar
from deepkoco.systems import SYSTEMS, Channel, Motion, Parameter, System

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
