"""Integration steps that are chosen by the log: their error is less than what the log can tell."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

pytest.importorskip("mujoco")

from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Trial
from deepkoco.fit.solve.fine_steps import UNSEEN, fine_steps, steps_to_compare, with_steps_cut
from deepkoco.fit.solve.prior import Prior
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem, any_system
from tests.oracle.mujoco_drives import make_drive
from tests.oracle.mujoco_robots import random_arm

EXACT = 64  # parts of a step of the unit
RATE, SECONDS = 100.0, 6.0


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    """A servo arm as a file, and windows of its motion, simulated in fine steps without noise."""
    robot = random_arm(np.random.default_rng(3), 3, "position")
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(robot.xml)
    system = ExtendedSystem(any_system(str(path)), ())
    drive = make_drive(robot, np.random.default_rng(4), SECONDS, RATE)
    t = np.arange(round(SECONDS * RATE)) / RATE
    goals = np.array([drive(i, np.zeros(3)) for i in range(len(t))])
    series = {c.name: Series(t, goals[:, k], c.unit, "command") for k, c in enumerate(system.commands)}
    shown = {
        c.name: Series(t, goals[:, k], c.unit, "measurement") for k, c in enumerate(system.measurements[:3])
    }
    windows = cut_windows([Recording(series | shown)], system, 1.0)
    return system, windows.with_value(simulated(system, windows, EXACT))


def fit_of(system, windows):
    problem = FitProblem(system, windows)
    values = dict.fromkeys(problem.names, 0.0) | {p.name: p.value for p in system.parameters}
    return problem.fit_one(Trial("own", (), Prior.empty(), values, windows.state), 1)


def simulated(system, windows, parts):
    cut = with_steps_cut(windows, parts)
    fit = fit_of(system, cut)
    return torch.where(cut.valid, cut.value - fit.residual * cut.sample_sd, 0.0)


def seen_by(unit, noise_sd):
    """The windows as sensors with so much noise show them."""
    system, windows = unit
    noise = torch.randn(windows.value.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    windows = replace(windows, noise=tuple(n._replace(sd=noise_sd) for n in windows.noise))
    return system, windows.with_value(windows.value + noise_sd * noise)


@pytest.mark.parametrize("noise_sd", [1e-4, 1e-5])
def test_steps_are_cut_until_their_error_is_less_than_a_fine_sensor_tells(unit, noise_sd):
    system, windows = seen_by(unit, noise_sd)
    parts = fine_steps(partial(FitProblem, system), windows, fit_of(system, windows))
    exact = simulated(system, windows, EXACT)
    told = [float(((simulated(system, windows, k) - exact) / noise_sd).square().sum()) for k in (1, parts)]
    assert told[1] < 2.0 * UNSEEN < told[0]  # the noise of this log counts as a little larger than it is


def test_steps_stay_where_the_sensor_is_coarse(unit):
    system, windows = seen_by(unit, 0.02)
    assert fine_steps(partial(FitProblem, system), windows, fit_of(system, windows)) == 1


def test_steps_stay_where_something_larger_is_missing(unit):
    system, windows = seen_by(unit, 1e-4)
    wrong = windows.with_value(windows.value + 0.05 * torch.sin(20.0 * windows.t))
    assert fine_steps(partial(FitProblem, system), wrong, fit_of(system, wrong)) == 1


def test_windows_keep_their_length_and_samples_when_their_steps_are_cut(unit):
    windows = unit[1]
    cut = with_steps_cut(windows, 4)
    assert cut.steps == 4 * windows.steps
    assert cut.length == pytest.approx(windows.length)
    assert torch.equal(cut.value, windows.value)


def test_a_fit_is_compared_on_steps_whose_errors_cannot_change_its_place(unit):
    system, windows = seen_by(unit, 1e-4)
    problem_of, fit = partial(FitProblem, system), fit_of(system, windows)
    parts = steps_to_compare(problem_of, windows, fit, replace(fit, chi2=0.99 * fit.chi2))
    exact = simulated(system, windows, EXACT)
    told = [float(((simulated(system, windows, k) - exact) / 1e-4).square().sum()) for k in (1, parts)]
    assert told[1] < UNSEEN < told[0]
    # A misfit that is larger by more than the errors explain stays larger.
    hopeless = replace(fit, chi2=fit.chi2 + 1e6 * told[0])
    assert steps_to_compare(problem_of, windows, hopeless, fit) == 1
