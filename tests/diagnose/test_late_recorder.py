"""Healthy logs whose commands act late and whose speeds are filtered: both are known before any cause is ranked."""

import mujoco
import numpy as np
import pytest

from deepkoco.diagnose.as_engine import as_engine_if_shown
from deepkoco.diagnose.baseline import Near
from deepkoco.diagnose.between_rows import as_recorded
from deepkoco.diagnose.healthy import learn_as_simulated
from deepkoco.diagnose.left_of_logs import LeftOfLogs
from deepkoco.fit.data.windows import cut_windows, window_length
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system
from tests.diagnose.test_as_engine import SLIDER

STEP, ROW = 0.0002, 0.002  # of the engine, and of the log [s]
LATE, FILTERED = 0.003, 0.004  # commands, and the speed [s]
NOISE, NOISE_OF_SPEED = 5e-6, 1e-3


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "slider.xml"
    path.write_text(SLIDER.format(damping=4.0, friction=3.0))
    return load_system(path)


@pytest.fixture(scope="module")
def log():
    """A log of MuJoCo, whose friction creeps, in short steps; its commands act late, its speeds are filtered."""
    model = mujoco.MjModel.from_xml_string(SLIDER.format(damping=4.0, friction=3.0))
    model.opt.timestep = STEP
    data, rng = mujoco.MjData(model), np.random.default_rng(5)
    t = np.arange(0.0, 9.0, ROW)
    effort = 4.5 * np.sin(2.0 * np.pi * 0.7 * t) + 2.5 * np.sin(2.0 * np.pi * 1.9 * t)
    place, speed, filtered = [], [], 0.0
    for k in range(len(t) * round(ROW / STEP)):
        if k % round(ROW / STEP) == 0:
            place.append(float(data.qpos[0]))
            speed.append(filtered)
        data.ctrl[:] = effort[max(int((k * STEP - LATE) / ROW + 1e-9), 0)]
        mujoco.mj_step(model, data)
        filtered += STEP / FILTERED * (float(data.qvel[0]) - filtered)
    place = np.array(place) + NOISE * rng.standard_normal(len(t))
    speed = np.array(speed) + NOISE_OF_SPEED * rng.standard_normal(len(t))
    return Recording(
        {
            "push": Series(t, effort, "1", "command"),
            "q_rail": Series(t, place, "m", "measurement"),
            "dq_rail": Series(t, speed, "m/s", "measurement"),
        }
    )


def test_late_commands_do_not_hide_friction_that_creeps(slider, log):
    length = window_length(slider)
    left = LeftOfLogs(cut_windows([log], slider, length))
    creeping = slider.with_engine("MuJoCo", 0.0)
    # Either alone leaves a large part of what the machine leaves.
    held, alone, late = left(slider), left(creeping), left.late(slider)
    assert min(alone.per_sample, late.per_sample) > 10.0
    assert left.late(creeping).per_sample < 0.1 * min(held.per_sample, alone.per_sample, late.per_sample)
    assert as_engine_if_shown([log], slider, length).engine == "MuJoCo"


def test_delays_of_a_recorder_are_learned_without_a_ranking(slider, log):
    length = window_length(slider)
    read = as_recorded([log], slider, length)
    assert read.near is not None
    plain = learn_as_simulated([log], read.system, length, extension=0, near=None)
    assert plain.floor > 10.0
    for near in (
        read.near,
        Near({}, None),
    ):  # where the question has found the delays, and where it has not asked
        learned = learn_as_simulated([log], read.system, length, extension=0, near=near)
        assert set(learned.effects) == {"actuation_delay", "channel_delay(dq_rail)"}
        assert learned.values["actuation_delay.delay"] == pytest.approx(LATE, abs=4e-4)
        assert learned.values["channel_delay(dq_rail).delay"] == pytest.approx(FILTERED, rel=0.15)
        assert learned.floor < 0.1 * plain.floor
