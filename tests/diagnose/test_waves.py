"""Loads that repeat along the way of a joint: what each wave number explains, from responses to even loads."""

import math

import numpy as np
import pytest
import torch

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.residuals.residuals import waves_of
from deepkoco.diagnose.residuals.waves import SLOTS, TINY
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.solve.fine_steps import with_steps_cut
from tests.diagnose.test_cogging_of_slides import Stage, recording


@pytest.fixture(scope="module", params=[(0.4, 1), (1.6, 1), (0.4, 4)])
def waves(request):
    """Windows of as many steps as slots at most, and of more; and in steps that are cut for their fit."""
    system, (length, parts) = Stage(), request.param
    windows = with_steps_cut(cut_windows([recording(8.0, 1)], system, length), parts)
    start = baseline_from(system, windows)
    return waves_of(FitProblem(start.system, windows), refit(start, windows), 0)


def test_sums_of_responses_explain_what_the_response_to_each_wave_does(waves):
    numbers = 2.0 * math.pi / np.array([0.11, 0.06, 0.024, 0.02])
    falls, sizes = waves.answering().explained(numbers)
    small = 1e-4
    basis, _ = torch.linalg.qr((waves._responses([], waves.fit.state.shape[1]) / TINY).permute(1, 2, 0))
    residual = waves.fit.residual.reshape(len(basis), -1, 1)
    coarse = waves.problem.with_usual_steps.windows.steps > SLOTS
    for number, fall, size in zip(numbers, falls, sizes, strict=True):
        pitch = 2.0 * math.pi / number
        each = np.array([[pitch, small, 0.0], [pitch, 0.0, small]])
        direct = (waves.responses(each, np.array([pitch, 0.0, 0.0])) / small).permute(1, 2, 0)
        direct = (direct - basis @ (basis.mT @ direct)).flatten(0, 1)
        rest = (residual - basis @ (basis.mT @ residual)).flatten()
        wanted = torch.linalg.lstsq(direct, rest[:, None]).solution[:, 0]
        gain = float((direct @ wanted) @ rest)
        # A slot of two steps has the mean of its load.
        assert fall == pytest.approx(gain, rel=0.05 if coarse else 1e-3)
        np.testing.assert_allclose(size, wanted, rtol=0.05 if coarse else 1e-3)


def test_the_pitch_that_is_hidden_explains_most(waves):
    pitches = np.array([0.11, 0.06, 0.036, 0.024, 0.02])
    falls, _ = waves.answering().explained(2.0 * math.pi / pitches)
    assert pitches[falls.argmax()] == 0.024
