"""estimate_noise and quantum_of on simulated series."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit.data.noise import estimate_noise, rates, stamp_jitter
from deepkoco.logs.quantum import quantum_of


@settings(max_examples=20, deadline=None)
@given(sd=st.floats(1e-4, 1.0), seed=st.integers(0, 2**16))
def test_estimate_noise_recovers_sd_on_smooth_motion_with_irregular_stamps(sd, seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.005, 0.015, 2000))
    value = 2.0 * np.sin(3.0 * t) + sd * rng.standard_normal(len(t))
    assert estimate_noise(t, value, 1.0).sd == pytest.approx(sd, rel=0.12)


def test_estimate_noise_ignores_outliers():
    rng = np.random.default_rng(0)
    t = np.arange(2000) / 100.0
    value = np.sin(t) + 0.01 * rng.standard_normal(2000)
    value[::400] += 5.0
    assert estimate_noise(t, value, 1.0).sd == pytest.approx(0.01, rel=0.15)


def test_estimate_noise_of_rounding_is_quantum_over_root_12():
    t = np.arange(1000) / 1000.0
    value = np.round(t * 3.0 / 0.01) * 0.01  # a slow ramp: steps are rare, differences mostly zero
    assert quantum_of(value) == pytest.approx(0.01)
    assert estimate_noise(t, value, 1.0).sd >= 0.01 / np.sqrt(12.0) * 0.999


def test_estimate_noise_uses_fallback_for_short_series():
    assert estimate_noise(np.arange(10.0), np.zeros(10), 0.7).sd == 0.7


def test_quantum_of_finds_encoder_steps_in_rounded_values():
    """The values have few digits, and unwrapping adds rounding errors."""
    ticks = np.random.default_rng(0).integers(-300, 300, 5000)
    value = np.round(ticks * 2.0 * np.pi / 2048.0, 7)
    value[::7] += 2.0 * np.pi
    value[::7] -= 2.0 * np.pi
    assert quantum_of(value) == pytest.approx(2.0 * np.pi / 2048.0, rel=1e-5)
    assert quantum_of(np.random.default_rng(1).normal(size=5000)) == 0.0
    # Each value occurs twice: as few levels as on a grid, but no common step.
    assert quantum_of(np.repeat(np.random.default_rng(2).normal(size=500), 2)) == 0.0


def _moving(seed: int, jitter: float, noise: float, quantum: float = 0.0):
    """Windows of a fast sine whose stamps scatter, with the residual that its true course leaves."""
    rng = np.random.default_rng(seed)
    t = np.tile(np.arange(200) / 100.0, (8, 1, 1))
    true = np.sin(6.0 * t + np.arange(8)[:, None, None])
    shown = np.sin(6.0 * (t + jitter * rng.standard_normal(t.shape)) + np.arange(8)[:, None, None])
    value = shown + noise * rng.standard_normal(t.shape)
    if quantum:
        value = quantum * np.round(value / quantum)
    return t, value, value - true, np.ones(t.shape, dtype=bool), np.array([quantum / np.sqrt(12.0)])


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(20000, 20500), jitter=st.floats(5e-5, 2e-3))
def test_stamp_jitter_is_recovered_from_residuals_that_grow_with_the_rate(seed, jitter):
    found, sd = stamp_jitter(*_moving(seed, jitter, 3.0 * jitter), 10.0, 0.005)
    assert found == pytest.approx(jitter, rel=0.25)
    assert sd[0] == pytest.approx(3.0 * jitter, rel=0.2)


@pytest.mark.parametrize("seed", range(20000, 20006))
def test_stamp_jitter_is_none_without_jitter_also_on_a_grid_and_under_a_smooth_model_error(seed):
    assert stamp_jitter(*_moving(seed, 0.0, 1e-3), 10.0, 0.005)[0] == 0.0
    t, value, residual, valid, least = _moving(seed, 0.0, 1e-5, quantum=1.5e-3)
    assert stamp_jitter(t, value, residual, valid, least, 10.0, 0.005)[0] == 0.0
    t, value, residual, valid, least = _moving(seed, 0.0, 1e-3)
    assert stamp_jitter(t, value, residual + 0.02 * np.sin(9.0 * t), valid, least, 10.0, 0.005)[0] == 0.0


def test_rates_are_slopes_of_the_samples_and_zero_where_padded():
    t = np.tile(np.arange(10) / 10.0, (1, 1, 1))
    valid = np.ones(t.shape, dtype=bool)
    valid[..., 7:] = False
    found = rates(np.where(valid, t, 0.0), np.where(valid, 3.0 * t, 0.0), valid)
    assert found[0, 0, :7] == pytest.approx(np.full(7, 3.0))
    assert not found[0, 0, 7:].any()
