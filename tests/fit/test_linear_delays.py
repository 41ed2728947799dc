"""mixture_law against the EM of scikit-learn, and on drawn delays."""

import numpy as np
import pytest
from sklearn.mixture import GaussianMixture

from deepkoco.fit.delays.linear_delays import LinearDelays, mixture_law


def seen(delays: np.ndarray, noise_sd: float, seed: int = 0, windows: int = 20) -> LinearDelays:
    """Likelihood of delays that are each measured once with noise; messages are distributed over windows."""
    rng = np.random.default_rng(seed)
    values = delays + noise_sd * rng.standard_normal(len(delays))
    members = np.array_split(np.arange(len(delays)), windows)
    return LinearDelays(
        members,
        [np.eye(len(m)) / noise_sd**2 for m in members],
        [values[m] / noise_sd**2 for m in members],
    )


def delays(count: int = 600) -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.where(rng.random(count) < 0.6, 0.01, 0.03) + 0.002 * rng.standard_normal(count)


def test_mixture_law_matches_scikit_learn_without_noise():
    true = delays()
    found = mixture_law(seen(true, 1e-5), true, 2, np.random.default_rng(2))
    theirs = GaussianMixture(2, random_state=0, tol=1e-8, reg_covar=1e-12).fit(1e3 * true[:, None])
    assert theirs.means_ is not None
    assert theirs.covariances_ is not None
    assert theirs.weights_ is not None
    order = np.argsort(theirs.means_[:, 0])
    assert found.means == pytest.approx(1e-3 * theirs.means_[order, 0], abs=1e-4)
    assert found.spreads == pytest.approx(1e-3 * np.sqrt(theirs.covariances_[order, 0, 0]), rel=0.03)
    assert found.weights == pytest.approx(theirs.weights_[order], abs=0.01)


def test_mixture_law_is_not_widened_by_noise():
    true, noise_sd = delays(1500), 0.002
    found = mixture_law(seen(true, noise_sd), true, 2, np.random.default_rng(2))
    assert found.means == pytest.approx([0.01, 0.03], abs=3e-4)
    assert found.spreads == pytest.approx(
        [0.002, 0.002], rel=0.15
    )  # without the correction for noise: 2.8 ms


def test_mixture_law_recovers_from_wrong_initial_components():
    true = delays()
    wrong = 0.04 - true  # every message starts in the other component
    found = mixture_law(seen(true, 0.001), wrong, 2, np.random.default_rng(2))
    assert np.abs(found.centre - true).max() < 0.006
    assert found.means == pytest.approx([0.01, 0.03], abs=5e-4)
