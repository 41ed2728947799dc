"""Time constants of delays that were sampled at irregular times."""

import numpy as np
import pytest
from scipy.stats import norm

from deepkoco.graph.delay import Autoregressive, Gaussian, OrnsteinUhlenbeck
from deepkoco.graph.episodes.fitting import FitError, fit_delays

MEAN, SD = 0.03, 0.004  # [s]


def process(gaps: np.ndarray, seconds: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Delays whose scores are an Ornstein-Uhlenbeck process seen after these gaps, and their stamps."""
    rng = np.random.default_rng(seed)
    z = np.zeros(len(gaps))
    z[0] = rng.standard_normal()
    for k in range(1, len(gaps)):
        a = np.exp(-gaps[k] / seconds)
        z[k] = a * z[k - 1] + np.sqrt(1.0 - a**2) * rng.standard_normal()
    return norm.ppf(norm.cdf(z), MEAN, SD), np.cumsum(gaps)


@pytest.mark.parametrize("seconds", [0.05, 0.2, 1.0])
def test_the_time_constant_is_recovered_from_irregular_stamps(seconds):
    gaps = np.random.default_rng(1).exponential(0.05, 6000)
    delay, stamps = process(gaps, seconds)
    law = fit_delays({"a->b": delay}, times={"a->b": stamps}).laws["a->b"]
    assert isinstance(law, OrnsteinUhlenbeck)
    assert law.time_constant == pytest.approx(seconds, rel=0.15)
    assert law.mean == pytest.approx(MEAN, rel=0.05)


def test_regular_stamps_give_one_correlation():
    delay, stamps = process(np.full(4000, 0.05), 0.2)
    law = fit_delays({"a->b": delay}, times={"a->b": stamps}).laws["a->b"]
    assert isinstance(law, Autoregressive)
    assert law.correlation == pytest.approx(np.exp(-0.05 / 0.2), abs=0.03)


def test_independent_delays_stay_so():
    rng = np.random.default_rng(2)
    delay, stamps = MEAN + SD * rng.standard_normal(4000), np.cumsum(rng.exponential(0.05, 4000))
    assert isinstance(fit_delays({"a->b": delay}, times={"a->b": stamps}).laws["a->b"], Gaussian)


def test_stamps_that_run_backwards_are_refused():
    with pytest.raises(FitError, match="growing stamps"):
        fit_delays({"a->b": np.full(20, 0.1)}, times={"a->b": np.zeros(20)})
