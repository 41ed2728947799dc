"""The limit of noise: chi2 per sample varies more where residuals are correlated."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.signal import lfilter

from deepkoco.diagnose.per_log_refits import floor_variance
from deepkoco.diagnose.residuals import coloured_from, white_limit
from deepkoco.diagnose.residuals.residuals import structured_from
from deepkoco.fit import Noise

SAMPLES, SHARE = 1500, 0.9


def correlated_noise(repeats: int, samples: int) -> np.ndarray:
    white = np.random.default_rng(20000).standard_normal((repeats, samples + 200))
    return np.asarray(lfilter([np.sqrt(1.0 - SHARE**2)], [1.0, -SHARE], white, axis=1))[:, 200:]


def windows_of(samples: int) -> Any:
    return SimpleNamespace(
        samples=samples,
        valid=torch.ones(1, 1, samples, dtype=torch.bool),
        noise=(SimpleNamespace(relative_sd=0.0),),
    )


def test_limit_is_so_many_deviations_of_chi2_of_correlated_noise():
    spread = np.square(correlated_noise(4000, SAMPLES)).mean(1).std()
    windows = windows_of(SAMPLES)
    correlation = (1.0 + SHARE) / (1.0 - SHARE)
    assert white_limit(windows, correlation, 4.0) - 1.0 == pytest.approx(4.0 * spread, rel=0.05)
    assert white_limit(windows, deviations=4.0) - 1.0 == pytest.approx(4.0 * np.sqrt(2.0 / SAMPLES))


def test_limit_counts_that_healthy_logs_only_estimate_what_a_sound_unit_leaves():
    # One log against the mean of three healthy ones: 1/n + 1/(3 n) as a variance.
    squares = np.square(correlated_noise(8000, SAMPLES)).mean(1).reshape(2000, 4)
    spread = (squares[:, 0] - squares[:, 1:].mean(1)).std()
    correlation = (1.0 + SHARE) / (1.0 - SHARE)
    limit = white_limit(windows_of(SAMPLES), correlation, 4.0, known=3 * SAMPLES)
    assert limit - 1.0 == pytest.approx(4.0 * spread, rel=0.05)


def test_floors_of_healthy_logs_that_differ_widen_the_limit():
    spreads: Any = [SimpleNamespace(chi2_per_sample=x, correlation=1.0) for x in (0.5, 1.0, 1.5)]
    # A variance of 0.25 between logs, less 2e-6 of chance; the mean of three adds a third of it.
    apart = floor_variance(spreads, [10**6] * 3)
    assert apart == pytest.approx(0.25 * 4.0 / 3.0, rel=1e-4)
    assert white_limit(windows_of(10**6), deviations=4.0, apart=apart) == pytest.approx(
        1.0 + 4.0 * np.sqrt(apart), rel=1e-3
    )


def test_floors_that_differ_by_chance_do_not_widen_the_limit():
    spreads: Any = [SimpleNamespace(chi2_per_sample=x, correlation=20.0) for x in (0.95, 1.0, 1.05)]
    assert floor_variance(spreads, [1000] * 3) == 0.0


def lag_one(residual: np.ndarray) -> float:
    return float((residual[1:] * residual[:-1]).mean() / np.square(residual).mean())


def test_what_a_simulation_cannot_follow_may_be_alike_in_neighbours():
    # Rounded commands move a joint by 0.8 noise deviations, the encoder scatters by 0.6.
    rng = np.random.default_rng(1)
    residual = 0.6 * rng.standard_normal(SAMPLES) + 0.8 * correlated_noise(1, SAMPLES)[0]
    windows = windows_of(SAMPLES)
    windows.noise = (Noise(1e-6, 0.0, 0.8e-6),)
    assert coloured_from(windows) < lag_one(residual) < structured_from(windows, np.square(residual).mean())
    # The same noise of a sensor alone would be white.
    windows.noise = (Noise(1e-6, 0.0),)
    assert structured_from(windows, 1.0) == coloured_from(windows)


def test_structure_that_is_larger_than_what_a_simulation_cannot_follow_is_seen():
    residual = 3.0 * correlated_noise(1, SAMPLES)[0]
    windows = windows_of(SAMPLES)
    windows.noise = (Noise(1e-6, 0.0, 0.8e-6),)
    assert lag_one(residual) > structured_from(windows, np.square(residual).mean())
