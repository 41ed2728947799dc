"""Windows of a system with steps of its own: whole steps between two commands, which nothing cuts."""

import numpy as np
import pytest
import torch

from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.own_steps import in_steps_of, nearest_own_step
from deepkoco.fit.data.usual_steps import with_usual_steps
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.solve.fine_steps import with_steps_cut
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system

URDF = """<robot name="slider"><link name="world"/>
<link name="box"><inertial><mass value="2"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="world"/><child link="box"/><axis xyz="1 0 0"/>
<limit lower="-50" upper="50" effort="100" velocity="100"/><dynamics damping="4" friction="3"/></joint></robot>"""


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "slider.urdf"
    path.write_text(URDF)
    return load_system(path)


def recorded(period, seconds=12.0):
    t = period * np.arange(round(seconds / period))
    return Recording(
        {
            "rail": Series(t, 5.0 * np.sin(3.0 * t), "N", "command"),
            "q_rail": Series(t, np.sin(t) + 1e-4 * np.cos(1e3 * t), "m", "measurement"),
        }
    )


@pytest.mark.parametrize(
    ("period", "stated", "step"),
    [(1 / 240, 0.0042, 1 / 240), (0.01, 0.001, 0.001), (0.01, 0.0027, 0.0025), (0.01, 0.5, 0.01)],
)
def test_a_whole_even_number_of_steps_between_commands(slider, period, stated, step):
    system = slider.with_engine("semi-implicit", stated)
    windows = cut_windows([recorded(period)], system, 1.0)
    assert windows.step == pytest.approx(step, rel=1e-9)
    assert windows.own_steps
    assert windows.steps % 2 == 0
    assert (windows.length / period) % 1.0 == pytest.approx(0.0, abs=1e-6)
    begins = (windows.t0 - windows.commands[0].t[0]) / period
    np.testing.assert_allclose(begins, begins.round(), atol=1e-6)


def test_windows_that_overlap_are_whole_steps_apart(slider):
    system = slider.with_engine("semi-implicit", 0.002)
    windows = cut_windows([recorded(0.01, 12.345)], system, 1.0, cover=True)
    apart = np.diff(windows.t0) / windows.step
    np.testing.assert_allclose(apart, apart.round(), atol=1e-6)


def test_nothing_cuts_or_joins_the_steps_of_an_engine(slider):
    system = slider.with_engine("semi-implicit", 0.001)
    windows = cut_windows([recorded(0.01)], system, 1.0)
    assert with_steps_cut(windows, 4) is windows
    assert with_usual_steps(windows, system) is windows
    assert halved(windows).step == windows.step
    assert halved(windows).steps == windows.steps // 2
    assert with_steps_cut(cut_windows([recorded(0.01)], slider, 1.0), 4).step == pytest.approx(0.0025)


def test_windows_of_a_machine_get_the_steps_of_an_engine_and_back(slider):
    windows = cut_windows([recorded(0.01)], slider, 1.0)
    stepped = in_steps_of(windows, slider.with_engine("semi-implicit", 0.0042))
    assert (stepped.step, stepped.steps, stepped.own_steps) == (pytest.approx(0.005), 2 * windows.steps, True)
    assert stepped.length == pytest.approx(windows.length)
    back = in_steps_of(in_steps_of(windows, slider.with_engine("semi-implicit", 0.01)), slider)
    assert (back.step, back.own_steps) == (pytest.approx(0.01), False)
    assert in_steps_of(windows, slider) is windows


def test_halves_of_an_odd_number_of_steps_keep_all_samples(slider):
    windows = in_steps_of(
        cut_windows([recorded(0.04)], slider, 1.0), slider.with_engine("semi-implicit", 0.04)
    )
    assert windows.steps == 25
    halves = halved(windows)
    assert (halves.steps, halves.step) == (13, windows.step)
    np.testing.assert_allclose(halves.t0[1::2] - halves.t0[::2], 12 * 0.04)
    assert float(halves.t[::2].max()) < 12 * 0.04
    assert float(halves.t.max()) < 13 * 0.04
    assert torch.equal(halves.value[0, :, :12], windows.value[0, :, :12])
    assert torch.equal(halves.value[1, :, :13], windows.value[0, :, 12:25])


def test_steps_of_commands_without_a_period_are_as_stated(slider):
    windows = cut_windows([recorded(0.01)], slider, 1.0)
    assert nearest_own_step(windows, 0.0042) == pytest.approx(0.005)
    assert nearest_own_step(windows, 0.0) == 0.0
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.004, 0.02, 1000))
    log = Recording(
        {"rail": Series(t, np.sin(t), "N", "command"), "q_rail": Series(t, np.sin(t), "m", "measurement")}
    )
    assert nearest_own_step(cut_windows([log], slider, 1.0), 0.0042) == 0.0042
