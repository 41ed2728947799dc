"""A sensor that shows a share of another joint."""

import mujoco
import numpy as np
import pytest
import torch

import deepkoco
from deepkoco.diagnose import diagnose
from deepkoco.diagnose.causes import catalogue
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem
from deepkoco.systems.registry import make_system

HEAD = """<mujoco model="head"><compiler angle="radian"/><worldbody>
<body><joint name="pan" axis="0 0 1" damping="0.05"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<body><joint name="tilt" axis="0 1 0" damping="0.03"/>
<inertial pos="0.05 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></body></worldbody>
<actuator><motor name="pan_motor" joint="pan"/><motor name="tilt_motor" joint="tilt"/></actuator></mujoco>"""
RATE, SECONDS, NOISE = 100, 12.0, 2e-4
NAME = "sensor_crosstalk(pan to tilt)"


@pytest.fixture
def head(tmp_path):
    (tmp_path / "head.xml").write_text(HEAD)
    return deepkoco.load_system(tmp_path / "head.xml")


def test_it_adds_a_share_of_the_position_to_the_position_and_of_the_speed_to_the_speed(head):
    extended = ExtendedSystem(head, (NAME,))
    state = torch.tensor([0.4, -0.2, 1.5, 0.3], dtype=torch.float64)
    values = {**extended.default_parameters(), f"{NAME}.share": torch.tensor(0.1, dtype=torch.float64)}
    plain = head.measure(state, head.default_parameters())
    shown = extended.measure(state, values)
    torch.testing.assert_close(shown - plain, torch.tensor([0.0, 0.04, 0.0, 0.15], dtype=torch.float64))
    torch.testing.assert_close(extended.measure(state, extended.default_parameters()), plain)


def test_it_has_no_meaning_where_one_joint_alone_is_there():
    assert not [name for name in catalogue(make_system("pendulum")) if name.startswith("sensor_crosstalk")]


@pytest.mark.study
@pytest.mark.timeout(300)
@pytest.mark.parametrize("share", [0.08, 0.0])
def test_a_share_of_another_joint_in_an_encoder_is_named_and_its_absence_is_not(head, share):
    rng, t = np.random.default_rng(4), np.arange(0.0, SECONDS, 1.0 / RATE)
    model = mujoco.MjModel.from_xml_string(
        HEAD.replace("<worldbody>", '<option timestep="0.0005"/><worldbody>')
    )
    data, rows = mujoco.MjData(model), []
    tones, phases = rng.uniform(0.2, 0.9, (3, 2)), rng.uniform(0.0, 2.0 * np.pi, (3, 2))
    for x in t:
        wanted = [0.4, 0.2] * np.sin(2.0 * np.pi * tones * x + phases).sum(0)
        data.ctrl[:] = 1.2 * (wanted - data.qpos) - 0.15 * data.qvel
        rows.append([*data.qpos, *data.ctrl])
        mujoco.mj_step(model, data, round(2000 / RATE))
    pan, tilt, *efforts = np.array(rows).T
    channels = {
        "q_pan": Series(t, pan + NOISE * rng.normal(size=len(t)), "rad", "measurement"),
        "q_tilt": Series(t, tilt + share * pan + NOISE * rng.normal(size=len(t)), "rad", "measurement"),
        "pan_motor": Series(t, efforts[0], "N m", "command"),
        "tilt_motor": Series(t, efforts[1], "N m", "command"),
    }
    found = diagnose(
        [Recording(channels)], head, only=["sensor_crosstalk", "crosstalk", "viscous", "force", "gain"]
    )
    assert found.names == ((NAME,) if share else ())
    if share:
        assert found.causes[0].parameters[f"{NAME}.share"].value == pytest.approx(share, rel=0.02)
