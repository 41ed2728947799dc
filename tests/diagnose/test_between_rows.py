"""Commands of a controller that is faster than its log act around their rows; those of a log's own loop do not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.as_engine import Closest, _explains_as_much, closest_of_logs
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.between_rows import _lead, as_recorded, lead_of_commands
from deepkoco.diagnose.left_of_logs import Left, LeftOfLogs
from deepkoco.excitation.record import record
from deepkoco.fit.data.noise import Noise
from deepkoco.fit.data.series import CommandSeries, channel_series
from deepkoco.fit.data.windows import cut_windows, moving
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.between_rows import changes_often, with_early_commands
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system, make_system
from deepkoco.unit import make_unit
from tests.diagnose.test_as_engine import SLIDER

ROW = 0.005  # [s]


@cache
def log():
    unit = make_unit("torque_pendulum", sensor={"rate_hz": 1.0 / ROW}, seed=3)
    return record(unit, "chirp", 10.0, clock="simulated", seed=3)


def smooth(t):
    return 0.4 * np.sin(2.0 * np.pi * 1.3 * t) + 0.2 * np.sin(2.0 * np.pi * 3.1 * t)


def logged(each, late=0.0):
    """Windows of a pendulum whose controller changes its command ``each`` times a row, late by some time [s]."""
    windows = cut_windows([log()], make_system("torque_pendulum"), 1.0)
    windows = replace(windows.take(moving(windows)), noise=(Noise(2e-5, 0.05), Noise(5e-3, 0.05)))
    start = baseline_from(make_system("torque_pendulum"), windows)
    end = float(windows.commands[0].t[-1])
    fast = np.arange(int(end / ROW) * each) * (ROW / each)
    acted = replace(windows, commands=(CommandSeries(fast + late, smooth(fast)),))
    problem = FitProblem(start.system, acted)
    theta = np.array([[float(start.values[n]) for n in problem.names]])
    shown = problem.predict(theta, windows.state[None], problem.nuisances.none()[None])[0]
    rng = torch.Generator().manual_seed(1)
    noise = windows.sample_sd * torch.randn(shown.shape, dtype=torch.float64, generator=rng)
    rows = CommandSeries(fast[::each], smooth(fast[::each]))
    return start, replace(windows.with_value((shown + noise) * windows.valid), commands=(rows,))


@pytest.mark.parametrize("each", [2, 5, 10])
def test_commands_of_a_faster_controller_act_before_their_rows(each):
    # Of n commands a row, the first one acts from the row on, and their mean is that of the row's middle less 1 / 2n.
    start, windows = logged(each)
    assert _lead(start, windows, ROW) == pytest.approx(0.5 * (1.0 - 1.0 / each) * ROW, abs=0.06 * ROW)


def test_commands_of_the_loop_that_logs_them_act_from_their_rows_on():
    start, windows = logged(1)
    assert _lead(start, windows, ROW) == 0.0


@pytest.mark.parametrize("late", [ROW, 2.4 * ROW])
def test_commands_that_are_late_act_after_their_rows(late):
    start, windows = logged(1, late)
    assert _lead(start, windows, ROW) == 0.0


@pytest.mark.parametrize("rows", [0.8, 1.0, 2.0])
def test_stamps_that_are_late_by_most_of_a_row_are_another_thing(rows):
    start, windows = logged(1, -rows * ROW)
    assert _lead(start, windows, ROW) == 0.0


def test_a_controller_that_is_slower_than_its_log_is_not_asked():
    t = np.arange(200) * ROW
    assert changes_often(smooth(t))
    assert not changes_often(np.repeat(smooth(t[::4]), 4))
    assert not changes_often(np.zeros(200))


def with_commands_at(recording, t):
    name = recording.names("command")[0]
    own = recording.channels[name]
    channels = {**recording.channels, name: replace(own, t=t, value=smooth(t))}
    return replace(recording, channels=channels)


def test_commands_with_stamps_of_their_own_keep_them():
    slow = with_commands_at(log(), np.arange(0.0, 10.0, 2.3 * ROW))
    assert lead_of_commands([slow], make_system("torque_pendulum"), 1.0) == 0.0


def test_a_log_says_from_when_on_its_commands_act():
    recording, system = replace(log(), unknown=((3.0, 4.0),)), make_system("torque_pendulum")
    moved = with_early_commands(recording, 0.002)
    (own, shown), (other, again) = (channel_series(each, system) for each in (recording, moved))
    np.testing.assert_allclose(other.t, own.t - 0.002)
    np.testing.assert_array_equal(other.value, own.value)
    for name, (t, value) in shown.items():
        np.testing.assert_array_equal(again[name][0], t)
        np.testing.assert_array_equal(again[name][1], value)
    assert moved.unknown == ((2.998, 4.0),)
    assert "2 ms before the rows" in moved.warnings[-1]
    assert with_early_commands(recording, 0.0) is recording


def test_healthy_logs_have_decided_for_others_of_their_recorder():
    system = make_system("torque_pendulum")
    learned = replace(baseline_from(system, cut_windows([log()], system, 1.0)), early=0.002)
    read = as_recorded([log()], system, 1.0, learned)
    (other,) = read.logs([log()])
    assert read.early == other.early == 0.002


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "slider.xml"
    path.write_text(SLIDER.format(damping=4.0, friction=3.0))
    return load_system(path)


def in_short_steps(step: float, noise: float, speed_noise: float | None = None) -> Recording:
    """A mass on a rail in semi-implicit steps, with commands and rows every 10 ms."""
    t = np.arange(0.0, 10.0, 0.01)
    effort = 3.5 * np.sin(2.0 * np.pi * 0.4 * t) + 1.5 * np.sin(2.0 * np.pi * 0.97 * t)
    place, speed, places, speeds = 0.0, 0.0, [], []
    for u in effort:
        places.append(place)
        speeds.append(speed)
        for _ in range(round(0.01 / step)):
            speed += step * (u - 4.0 * speed) / 2.0
            speed = np.sign(speed) * max(abs(speed) - step * 3.0 / 2.0, 0.0)
            place += step * speed
    rng = np.random.default_rng(0)
    seen = np.array(places) + noise * rng.standard_normal(len(t))
    series = {"push": Series(t, effort, "1", "command"), "q_rail": Series(t, seen, "m", "measurement")}
    if speed_noise is not None:
        shown = np.array(speeds) + speed_noise * rng.standard_normal(len(t))
        series["dq_rail"] = Series(t, shown, "m/s", "measurement")
    return Recording(series)


@pytest.mark.parametrize("step", [0.0005, 0.001])
def test_short_steps_of_an_engine_are_a_machine_with_early_commands(slider, step):
    # The steps of 0.5 ms took three times as long as those of a machine, and 0.2 ms ten times.
    read = as_recorded([in_short_steps(step, 2e-6)], slider, 1.0)
    assert read.system.engine is None
    assert read.early == pytest.approx(0.5 * step, rel=0.1)
    assert read.near is not None
    assert read.near.values["frictionloss(rail)"] == pytest.approx(3.0, rel=2e-3)


def test_short_steps_are_told_beside_what_no_simulation_explains(slider):
    # Where half of what a machine leaves had to go, ten steps of engines were asked, and none left only noise.
    recording = with_a_tone(in_short_steps(0.001, 6e-6), 6e-6, 4.0)
    held = LeftOfLogs(cut_windows([recording], slider, 1.0))(slider)
    found = closest_of_logs([recording], slider, 1.0)
    assert found.system.engine is None
    assert found.lead == pytest.approx(0.0005, rel=0.1)
    assert 1.3 < found.left.per_sample < 1.6
    assert found.left.cost > 0.55 * held.cost


def with_a_tone(recording: Recording, size: float, frequency: float) -> Recording:
    place = recording.channels["q_rail"]
    value = place.value + size * np.sin(2.0 * np.pi * frequency * place.t)
    return Recording({**recording.channels, "q_rail": replace(place, value=value)})


@pytest.mark.parametrize(("creeping", "taken"), [(2.4, True), (1.41, True), (0.85, False)])
def test_early_commands_are_taken_where_the_engine_of_the_file_leaves_no_less(slider, creeping, taken):
    # Friction that creeps leaves 1.4 noise variances of a machine with early commands.
    class Leaves:
        noise = 1.2

        def __call__(self, law):
            return Left(2000.0 * creeping, creeping)

    early = Closest(slider, Left(2800.0, 1.4), lead=2e-4)
    held = Left(3000.0, 1.5)
    assert _explains_as_much(early, slider, Leaves(), held, lambda step: step) is taken
    assert _explains_as_much(early._replace(left=Left(2300.0, 1.15)), slider, Leaves(), held, float)


def test_early_commands_stay_where_the_engine_of_the_file_runs_away(slider):
    class Diverges:
        noise = 1.2

        def __call__(self, law):
            raise DivergedError("far away")

    early = Closest(slider, Left(2800.0, 1.4), lead=2e-4)
    assert _explains_as_much(early, slider, Diverges(), Left(3000.0, 1.5), float)


def test_long_steps_of_an_engine_stay_those_of_an_engine(slider):
    read = as_recorded([in_short_steps(0.0025, 2e-6)], slider, 1.0)
    assert read.system.engine == "semi-implicit"
    assert read.system.engine_step == pytest.approx(0.0025, rel=1e-6)
    assert read.early == 0.0


@pytest.mark.parametrize("late", [0.0, 0.004])
def test_commands_that_act_on_time_or_late_have_no_lead(slider, late):
    moved = with_early_commands(in_short_steps(0.001, 2e-6), 0.0005 + late)
    early = LeftOfLogs(cut_windows([moved], slider, 1.0)).early(slider)
    assert early is None or early.lead < 2e-5


@pytest.mark.study
@pytest.mark.parametrize("speed_noise", [1e-3, 1e-4])
def test_a_healthy_log_in_short_steps_lacks_nothing(slider, speed_noise):
    # Its speeds are half a step late, which the machine does not know.
    assert diagnose([in_short_steps(0.001, 2e-6, speed_noise)], slider).verdict == "nothing"
