"""Commands that a log holds in few digits: what the rounding does to a simulation is noise and no fault."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from deepkoco import Channel, Parameter, System
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Trial
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.rounded_commands import with_rounded_commands
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem

PERIOD, SECONDS, SENSOR = 0.01, 40.0, 1e-6


class Slide(System):
    """A carriage of 1 kg on a rail without friction, with a fine scale."""

    joint_units = ("m",)
    parameters = (Parameter("mass", 1.0, "kg", 0.1, 10.0, 0.01, "m"),)
    commands = (Channel("force", "N", "command", -10.0, 10.0),)
    measurements = (Channel("position", "m", "measurement", noise_sd=SENSOR),)

    def accelerations(self, p):
        return lambda motion: ((motion.efforts[0] + motion.load(0)) / p["mass"],)


def fit_of(grid, logged_grid, seed=0, sensor=SENSOR):
    """Windows of a log whose forces are on `grid` and are written on `logged_grid` [N], and their fit."""
    rng, system = np.random.default_rng(seed), ExtendedSystem(Slide(), ())
    t = PERIOD * np.arange(round(SECONDS / PERIOD))
    force = grid * np.round(2.0 * np.sin(3.0 * t) / grid + rng.normal(0.0, 0.2, len(t)) / grid)
    speed = np.append(0.0, np.cumsum(force)[:-1]) * PERIOD
    way = np.append(0.0, np.cumsum(speed[:-1] * PERIOD + 0.5 * force[:-1] * PERIOD**2))
    written = logged_grid * np.round(force / logged_grid)
    log = Recording(
        {
            "force": Series(t, written, "N", "command"),
            "position": Series(t, way + sensor * rng.standard_normal(len(t)), "m", "measurement"),
        }
    )
    windows = cut_windows([log], system, 1.0)
    windows = replace(windows, noise=tuple(n._replace(sd=sensor) for n in windows.noise))
    problem = FitProblem(system, windows)
    values = dict.fromkeys(problem.names, 0.0) | {p.name: p.value for p in system.parameters}
    state, _ = problem.fit_states(values, windows.state)
    return (
        partial(FitProblem, system),
        windows,
        problem.fit_one(Trial("own", (), Prior.empty(), values, state), 3),
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_roundings_of_the_log_count_as_noise(seed):
    problem_of, windows, fit = fit_of(1e-9, 1e-2, seed)
    assert fit.chi2 / windows.samples > 10.0
    noisy = with_rounded_commands(problem_of, windows, fit)
    left = fit.chi2 / windows.samples * (windows.noise[0].sd / noisy.noise[0].sd) ** 2
    assert left < 1.0 + 1e-9  # an upper estimate, and no more than the fit has left
    assert noisy.noise[0].sd < 2.0 * float((fit.residual * windows.sample_sd).square().mean().sqrt())


def test_something_larger_than_the_roundings_stays_more_than_noise():
    problem_of, windows, fit = fit_of(1e-9, 1e-2)
    t = windows.t
    pushed = windows.with_value(torch.where(windows.valid, windows.value + 1e-2 * torch.sin(20.0 * t), 0.0))
    problem = problem_of(pushed)
    state, _ = problem.fit_states(fit.values, fit.state)
    worse = problem.fit_one(Trial("own", (), Prior.empty(), fit.values, state), 3)
    noisy = with_rounded_commands(problem_of, pushed, worse)
    assert worse.chi2 / pushed.samples * (pushed.noise[0].sd / noisy.noise[0].sd) ** 2 > 100.0


@pytest.mark.parametrize("grid", [0.5, 1e-9])
def test_commands_of_few_levels_and_commands_in_all_digits_are_exact(grid):
    problem_of, windows, fit = fit_of(grid, grid)
    assert with_rounded_commands(problem_of, windows, fit) is windows


def test_a_sensor_that_is_coarser_than_what_roundings_do_keeps_its_noise():
    problem_of, windows, fit = fit_of(1e-9, 1e-2, sensor=1e-2)
    noisy = with_rounded_commands(problem_of, windows, fit)
    assert noisy.noise[0].sd == pytest.approx(1e-2, rel=0.02)
