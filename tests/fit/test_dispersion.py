"""Dispersion of residuals: what counts as an independent sample does not depend on the sample rate."""

import numpy as np
import pytest
import torch

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.fit import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system
from tests.studied import studied

FINE, SECONDS = 1000, 40.0  # rate of the path [Hz], length [s]


def path(correlation_time: float, seed: int) -> np.ndarray:
    """A stationary process with that correlation time, unit variance."""
    rng, keep = np.random.default_rng(seed), np.exp(-1.0 / (FINE * correlation_time))
    values = [rng.standard_normal()]
    for shock in rng.standard_normal(round(SECONDS * FINE)) * np.sqrt(1.0 - keep**2):
        values.append(keep * values[-1] + shock)
    return np.array(values)


def found(errors: np.ndarray, rate: int):
    """Dispersion of these errors, sampled at a rate."""
    picked = errors[:: FINE // rate]
    t = np.arange(len(picked)) / rate
    channels = {
        "torque": Series(t, 0.1 * np.sin(t), "N m", "command"),
        "theta": Series(t, picked, "rad", "measurement"),
    }
    system = make_system("rod_pendulum")
    windows = cut_windows([Recording(channels)], system, 1.0)
    start = baseline_from(system, windows)
    fit = FitProblem(start.system, windows).evaluate(start.values, "given")
    c = [channel.name for channel in system.measurements].index("theta")
    fit.residual = torch.zeros_like(fit.residual)
    fit.residual[:, c] = torch.where(windows.valid[:, c], windows.value[:, c], 0.0)
    return dispersion(fit, windows), windows.samples


@pytest.mark.parametrize("seed", studied(range(3), (0,)))
def test_independent_samples_of_a_model_error_do_not_grow_with_the_sample_rate(seed):
    errors = path(0.05, seed)
    counts = []
    for rate in (100, 1000):
        spread, samples = found(errors, rate)
        counts.append(samples / spread.correlation)
    assert counts[1] == pytest.approx(counts[0], rel=0.3)


def test_white_noise_has_one_independent_sample_a_sample():
    spread, _ = found(np.random.default_rng(0).standard_normal(round(SECONDS * FINE) + 1), 1000)
    assert spread.correlation == pytest.approx(1.0, abs=0.1)
    assert spread.chi2_per_sample == pytest.approx(1.0, rel=0.05)
