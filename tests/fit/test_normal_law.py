"""normal_law against the multivariate normal distribution of SciPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from deepkoco.fit.delays.linear_delays import SMALLEST_SPREAD, LinearDelays
from deepkoco.fit.delays.normal_law import DROP_95, NormalLaw, normal_law


def linear(mean: float, spread: float, seed: int, windows: int = 12, each: int = 8) -> LinearDelays:
    """Delays measured by random linear responses with noise of 2 ms."""
    rng = np.random.default_rng(seed)
    members = np.array_split(np.arange(windows * each), windows)
    information, pull = [], []
    for own in members:
        response = rng.standard_normal((3 * len(own), len(own))) / 0.002
        seen = response @ (mean + spread * rng.standard_normal(len(own))) + rng.standard_normal(3 * len(own))
        information.append(response.T @ response)
        pull.append(response.T @ seen)
    return LinearDelays(members, information, pull)


def log_likelihood(data: LinearDelays, mean: float, spread: float) -> float:
    """Log likelihood of a law: A^-1 h is the sum of the delays and noise with covariance A^-1."""
    total = 0.0
    for a, h in zip(data.information, data.pull, strict=True):
        noise = np.linalg.inv(a)
        covariance = spread**2 * np.eye(len(a)) + noise
        law = multivariate_normal(np.full(len(a), mean), covariance)  # pyright: ignore[reportArgumentType]
        total += float(law.logpdf(noise @ h))
    return total


@pytest.mark.parametrize("spread", [0.003, 0.0])
def test_normal_law_maximises_the_likelihood_of_scipy(spread):
    data = linear(0.02, spread, 0)
    law = normal_law(data)
    best = log_likelihood(data, law.mean, law.spread)
    for mean, factor in [(1e-5, 1.0), (-1e-5, 1.0), (0.0, 1.05), (0.0, 0.95)]:
        other = max(law.spread * factor, SMALLEST_SPREAD)
        assert log_likelihood(data, law.mean + mean, other) <= best + 1e-6
    constant = max(log_likelihood(data, law.mean + x, SMALLEST_SPREAD) for x in np.linspace(-1e-3, 1e-3, 401))
    assert law.evidence == pytest.approx(2.0 * (best - constant), abs=0.02)


def test_normal_law_spread_interval_ends_at_the_likelihood_drop():
    data = linear(0.02, 0.003, 1)
    law = normal_law(data)
    best = log_likelihood(data, law.mean, law.spread)
    for end in law.spread_interval:
        means = law.mean + np.linspace(-3.0, 3.0, 601) * law.mean_sd
        assert max(log_likelihood(data, m, end) for m in means) == pytest.approx(best - DROP_95, abs=1e-3)


def test_normal_law_mean_sd_matches_the_curvature_of_the_likelihood():
    data = linear(0.02, 0.003, 2)
    law = normal_law(data)
    fall = [log_likelihood(data, law.mean + k * law.mean_sd, law.spread) for k in (-1.0, 0.0, 1.0)]
    assert fall[1] - fall[0] == pytest.approx(0.5, rel=1e-3)
    assert fall[1] - fall[2] == pytest.approx(0.5, rel=1e-3)


def test_normal_law_spread_interval_begins_at_zero_for_constant_delays():
    law = normal_law(linear(0.02, 0.0, 3))
    assert law.spread_interval[0] == 0.0
    assert law.spread <= law.spread_interval[1] < 0.002


@settings(max_examples=25, deadline=None)
@given(
    mean=st.floats(-0.02, 0.05),
    spread=st.sampled_from([0.0, 1e-4, 1e-3, 5e-3]),
    seed=st.integers(0, 1000),
)
def test_normal_law_is_independent_of_rounding(mean, spread, seed):
    data = linear(mean, spread, seed)
    rng = np.random.default_rng(seed)

    def off(x: np.ndarray) -> np.ndarray:
        return x * (1.0 + 1e-13 * rng.standard_normal(x.shape))

    # The information must stay symmetric.
    moved = [0.5 * (a + a.T) for a in map(off, data.information)]
    first = normal_law(data)
    other = normal_law(LinearDelays(data.members, moved, [off(h) for h in data.pull]))
    assert other.mean == pytest.approx(first.mean, abs=1e-9)
    assert other.mean_sd == pytest.approx(first.mean_sd, rel=1e-5)
    assert other.spread_interval == pytest.approx(first.spread_interval, rel=1e-4, abs=1e-7)
    assert other.evidence == pytest.approx(first.evidence, abs=1e-4)


def test_normal_law_has_no_mean_without_information():
    own = np.arange(4)
    law = normal_law(LinearDelays([own], [np.zeros((4, 4))], [np.zeros(4)]))
    assert law == NormalLaw(0.0, law.spread, np.inf, law.spread_interval, 0.0)
