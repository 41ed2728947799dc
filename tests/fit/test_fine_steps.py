"""Integration steps that are chosen by the log: their error is less than what the log can tell."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch

pytest.importorskip("mujoco")

from deepkoco.fit.fit import FitProblem
from deepkoco.fit.solve.fine_steps import (
    MOST,
    UNSEEN,
    fine_steps,
    steps_to_compare,
    with_steps_cut,
    with_steps_of,
)
from tests.oracle.fine_arm import EXACT, fine_arm, fit_of, seen, simulated


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    return fine_arm(tmp_path_factory.mktemp("arm"))


def seen_by(unit, noise_sd):
    system, windows = unit
    return system, seen(windows, noise_sd)


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


def test_windows_get_the_steps_that_others_of_their_recorder_need(unit):
    windows = unit[1]
    assert with_steps_of(windows, math.inf) is windows
    assert with_steps_of(windows, 0.98 * windows.step).steps == windows.steps
    assert with_steps_of(windows, 0.5 * windows.step).steps == 2 * windows.steps
    assert with_steps_of(windows, 0.3 * windows.step).steps == 4 * windows.steps
    assert with_steps_of(windows, 1e-9).steps == MOST * windows.steps
    own = replace(windows, own_steps=True)
    assert with_steps_of(own, 0.3 * windows.step).steps == windows.steps
