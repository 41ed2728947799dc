"""A filter of the speeds is not taken for the steps of an engine, nor for a lead of the commands."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.diagnose import late_speeds, left_of_logs
from deepkoco.diagnose.as_engine import closest_of_logs
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.late_speeds import delay_of_speeds, with_late_speeds
from deepkoco.diagnose.left_of_logs import Left
from deepkoco.diagnose.the_other_way import _counts
from deepkoco.fit.data.windows import cut_windows, window_length
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system, make_system
from tests.oracle.unit import hidden_log

ROW, STEP = 0.005, 0.0002  # [s]
FILTER = 0.006  # time constant of the speed [s]
SLIDER = """
<mujoco model="slider"><option timestep="0.001"/>
<worldbody><body><joint name="rail" type="slide" axis="1 0 0" damping="4" frictionloss="3"/>
  <geom type="box" size="0.1 0.1 0.1" mass="2"/></body></worldbody>
<actuator><motor name="push" joint="rail"/></actuator></mujoco>
"""


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "slider.xml"
    path.write_text(SLIDER)
    return load_system(path)


@pytest.fixture(scope="module")
def filtered():
    """A log of MuJoCo in short steps whose drive filters its speed."""
    model = mujoco.MjModel.from_xml_string(SLIDER)
    model.opt.timestep = STEP
    data, shown, slow = mujoco.MjData(model), [], 0.0
    t = np.arange(0.0, 10.0, ROW)
    effort = 3.5 * np.sin(2.0 * np.pi * 0.4 * t) + 1.5 * np.sin(2.0 * np.pi * 0.97 * t)
    for u in effort:
        shown.append((float(data.qpos[0]), slow))
        for _ in range(round(ROW / STEP)):
            data.ctrl[:] = u
            mujoco.mj_step(model, data)
            slow += (1.0 - np.exp(-STEP / FILTER)) * (float(data.qvel[0]) - slow)
    place, speed = np.array(shown).T
    rng = np.random.default_rng(0)
    return Recording(
        {
            "push": Series(t, effort, "1", "command"),
            "q_rail": Series(t, place + 2e-6 * rng.standard_normal(len(t)), "m", "measurement"),
            "dq_rail": Series(t, speed + 1e-3 * rng.standard_normal(len(t)), "m/s", "measurement"),
        }
    )


def test_a_filtered_speed_does_not_lengthen_the_steps_of_an_engine(slider, filtered, monkeypatch):
    found = closest_of_logs([filtered], slider, window_length(slider))
    assert found.system.engine == "MuJoCo"
    assert found.system.engine_step <= 2.0 * STEP
    assert found.left.per_sample < 1.5
    # What it says of the body begins further fits; the delay may be what is hidden in the log.
    assert set(found.near.values) == set(
        baseline_from(slider, cut_windows([filtered], slider, 1.0)).prior.names
    )
    monkeypatch.setattr(left_of_logs, "with_late_speeds", lambda start, windows: start)
    without = closest_of_logs([filtered], slider, window_length(slider))
    assert without.left.per_sample > 2.0 * found.left.per_sample


def test_one_speed_is_late_by_itself_and_several_by_the_same_time():
    for name, expected in (
        ("rod_pendulum", "channel_delay(omega).delay"),
        ("two_link_arm", "speed_delay.delay"),
    ):
        base = make_system(name)
        windows = cut_windows([hidden_log(name, {}, "steps", 3, 4.0)], base, 1.0)
        start = baseline_from(base, windows)
        assert delay_of_speeds(start.system, windows) == expected
        assert with_late_speeds(start, windows).prior.names == (*start.prior.names, expected)


@pytest.mark.parametrize("kept", [range(2), range(2, 4)])
def test_positions_or_speeds_alone_have_no_delay_beside_the_others(kept):
    base = make_system("two_link_arm")
    windows = cut_windows([hidden_log("two_link_arm", {}, "steps", 3, 4.0)], base, 1.0)
    shown = torch.tensor([s in kept for s in base.measured_states])
    windows = replace(windows, valid=windows.valid & shown[:, None])
    start = baseline_from(base, windows)
    assert late_speeds.delay_of_speeds(start.system, windows) is None
    assert with_late_speeds(start, windows) is start


@pytest.mark.parametrize(
    ("other", "now", "counts"),
    [
        (8.5, 8.8, False),  # any change leaves a little less of a robot that is described badly
        (1.0, 30.0, True),
        (1.0, 1.3, True),
        (1.2, 1.3, False),
        (0.7, 0.9, True),  # noise alone: the likelihood decides
    ],
)
def test_other_steps_count_where_they_leave_half_of_what_is_no_noise(other, now, counts):
    assert _counts(Left(1e4 * other, other), Left(1e4 * now, now)) is counts
