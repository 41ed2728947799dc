"""Commands of which the log itself tells most of the noise that no motor felt."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.excitation.record import record
from deepkoco.fit.data.likely_commands import _response, likely_commands
from deepkoco.fit.data.series import CommandSeries
from deepkoco.fit.data.windows import cut_windows, moving
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Trial
from deepkoco.fit.solve.command_noise import with_command_noise, with_noise_like
from deepkoco.fit.solve.prior import Prior
from deepkoco.systems import make_system
from deepkoco.unit import make_unit

SD = 0.3
MUCH = 2.0  # a quarter of the largest torque [N m]


def smooth(n=4000):
    t = 0.01 * np.arange(n)
    return t, 2.0 * np.sin(0.8 * t) + 1.5 * np.sin(2.3 * t + 1.0) + 0.2 * t


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


def test_most_of_the_noise_of_a_smooth_command_is_taken_out():
    t, value = smooth()
    noise = SD * np.random.default_rng(0).standard_normal(len(t))
    found = likely_commands([CommandSeries(t, value + noise)], (SD,))[0].value
    assert rms(found - value) < 0.35 * SD
    # Its slow part stays as it is, at both ends, too.
    assert abs(np.mean(found - value - noise)) < 0.05 * SD
    assert rms((found - value)[:100]) < 0.7 * SD
    assert rms((found - value)[-100:]) < 0.7 * SD


def test_what_stays_of_the_noise_is_independent_of_the_commands_that_are_left():
    rng = np.random.default_rng(1)
    t = 0.01 * np.arange(20_000)
    # A command of the power spectrum of a first-order lag.
    acted = np.zeros(len(t))
    for k in range(1, len(t)):
        acted[k] = 0.95 * acted[k - 1] + 0.2 * rng.standard_normal()
    logged = acted + SD * rng.standard_normal(len(t))
    left = likely_commands([CommandSeries(t, logged)], (SD,))[0].value
    # The slope of what acted over what is left is 1, over what was logged less.
    assert np.polyfit(left, acted, 1)[0] == pytest.approx(1.0, abs=0.03)
    assert np.polyfit(logged, acted, 1)[0] < 0.85
    jumps = np.diff(left), np.diff(acted)
    assert np.polyfit(*jumps, 1)[0] == pytest.approx(1.0, abs=0.15)


def test_noise_that_the_log_does_not_hold_stays_in_no_command():
    t, value = smooth()
    both = np.column_stack([value, value**2])
    found = likely_commands([CommandSeries(t, both)], (0.0, 0.0))[0].value
    np.testing.assert_array_equal(found, both)


def test_rows_that_repeat_a_command_repeat_what_is_left_of_it():
    t, value = smooth(8000)
    held = np.repeat(value[::4] + SD * np.random.default_rng(2).standard_normal(2000), 4)
    # Noise of four rows does as much as twice that of independent ones.
    found = likely_commands([CommandSeries(t, held)], (2.0 * SD,))[0].value
    assert not np.diff(found.reshape(-1, 4), axis=1).any()
    assert rms(found - np.repeat(value[::4], 4)) < 0.45 * SD


@given(n=st.integers(1, 140), told=st.floats(0.0, 10.0))
def test_short_logs_keep_finite_commands(n, told):
    rng = np.random.default_rng(n)
    value = rng.standard_normal(n)
    found = likely_commands([CommandSeries(np.arange(n) * 0.01, value)], (told,))[0].value
    assert found.shape == value.shape
    assert np.isfinite(found).all()


@pytest.mark.parametrize("rest", [0.0, -5.0])
def test_a_rest_and_a_limit_are_exact(rest):
    t, value = smooth()
    noisy = np.clip(value + SD * np.random.default_rng(3).standard_normal(len(t)), -2.5, 4.0)
    noisy[1000:2000] = rest
    found = likely_commands([CommandSeries(t, noisy)], (SD,))[0].value
    np.testing.assert_array_equal(found[1000:2000], rest)
    limit = np.flatnonzero(
        (np.abs(noisy[1:-1]) == 4.0) & (noisy[:-2] == noisy[2:]) & (noisy[1:-1] == noisy[2:])
    )
    at = limit[np.convolve(np.isin(np.arange(len(t)), limit), np.ones(5), "same")[limit] == 5.0] + 1
    assert len(at) > 20
    np.testing.assert_array_equal(found[at], noisy[at])


@pytest.mark.parametrize("n", [128, 400, 4000])
def test_the_mean_of_a_command_stays(n):
    t, value = smooth(n)
    for seed in range(5):
        noise = SD * np.random.default_rng(seed).standard_normal(n)
        found = likely_commands([CommandSeries(t, 10.0 + value + noise)], (SD,))[0].value
        assert abs(np.mean(found - 10.0 - value - noise)) < 0.02


def test_noise_of_the_highest_frequency_counts_as_that_of_others():
    noise = np.random.default_rng(4).standard_normal(4000)
    told = np.sqrt(0.3)
    response = _response([noise], told**2, 256)
    share = np.fft.rfft(np.concatenate([response, response[-2:0:-1]])).real
    np.testing.assert_allclose(share[20:-1].mean(), 0.3, rtol=0.1)
    assert share[-1] == pytest.approx(0.3, rel=0.5)


def test_short_logs_take_the_spectrum_from_all_of_them():
    t, value = smooth(600)
    noise = SD * np.random.default_rng(6).standard_normal(len(t))
    logs = [CommandSeries(t[k : k + 60], (value + noise)[k : k + 60]) for k in range(0, 600, 60)]
    found = likely_commands(logs, (SD,))
    assert rms(np.concatenate([own.value for own in found]) - value) < 0.6 * SD


@cache
def measured():
    """Windows of a pendulum's log with noise of its torque that no motor felt."""
    system = make_system("torque_pendulum")
    unit = make_unit("torque_pendulum", sensor={"rate_hz": 200.0}, seed=3)
    recording = record(unit, "chirp", 20.0, clock="simulated", seed=3)
    name = recording.names("command")[0]
    torque, rng = recording.channels[name], np.random.default_rng(5)
    noisy = replace(torque, value=torque.value + MUCH * rng.standard_normal(len(torque)))
    windows = cut_windows([replace(recording, channels={**recording.channels, name: noisy})], system, 1.0)
    windows = windows.take(moving(windows))
    return baseline_from(system, windows), windows


@cache
def refitted():
    start, windows = measured()
    return start, windows, *refit_sharply(start, windows)


def estimate(start, windows, fit, name, value):
    """Estimate of a parameter of an effect, from a value at which it damps noise."""
    problem = FitProblem(start.system, windows)
    free = (*fit.free, name)
    covariance = np.zeros((len(free), len(free)))
    covariance[:-1, :-1] = start.prior.covariance
    covariance[-1, -1] = 100.0
    null = problem.null_values()[problem.names.index(name)]
    prior = Prior(free, np.append(start.prior.centre, null), covariance)
    trial = Trial(name, free, prior, {**fit.values, name: value}, fit.state, fit.nuisance)
    return problem.fit_one(trial).values[name]


@pytest.mark.parametrize(
    ("name", "value", "truth", "within", "damped"),
    [("lag.time_constant", 0.02, 0.0, 0.002, 0.01), ("gain.factor", 0.8, 1.0, 0.04, 0.92)],
)
def test_no_effect_gains_by_damping_noise_of_commands(name, value, truth, within, damped):
    start, windows, noisy, fit = refitted()
    assert noisy.wander is not None
    assert noisy.wander.logged[0] == pytest.approx(MUCH, rel=0.15)
    assert abs(estimate(start, noisy, fit, name, value) - truth) < within
    # With the noise still in the commands, damping it pays.
    raw = replace(noisy, commands=windows.commands)
    assert abs(estimate(start, raw, fit, name, value) - truth) > abs(damped - truth)


def test_other_logs_of_the_recorder_get_their_likely_commands():
    start, windows = measured()
    found = with_command_noise(partial(FitProblem, start.system), windows, start.values, windows.state)
    again = with_noise_like(partial(FitProblem, start.system), windows, start.values, found.wander)
    np.testing.assert_array_equal(again.commands[0].value, found.commands[0].value)
    assert rms(np.diff(found.commands[0].value)) < 0.8 * rms(np.diff(windows.commands[0].value))
