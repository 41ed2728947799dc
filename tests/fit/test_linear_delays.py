"""mixture_law against the EM of scikit-learn, and on drawn delays."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.mixture import GaussianMixture

from deepkoco.fit.delays.linear_delays import LinearDelays, MixtureLaw, _Components, mixture_law
from tests.studied import studied


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


def entangled(delays: np.ndarray, seed: int = 0, each: int = 20) -> LinearDelays:
    """Delays of pushes of a mass whose position is measured: neighbours explain nearly the same motion."""
    rng = np.random.default_rng(seed)
    members = [np.arange(k, k + each) for k in range(0, len(delays), each)]
    t = 0.005 * np.arange(10 * each)
    information, pull = [], []
    for own in members:
        # What acts later by eps gives a speed that is lower by eps times the change of the acceleration.
        change = rng.uniform(-4.0, 4.0, each)
        response = -change * np.maximum(t[:, None] - 0.05 * np.arange(each), 0.0) / 0.0005
        seen = response @ delays[own] + rng.standard_normal(len(t))
        information.append(response.T @ response)
        pull.append(response.T @ seen)
    return LinearDelays(members, information, pull)


@pytest.mark.parametrize("seed", studied(range(3), (0,)))
def test_the_law_forgets_where_the_draws_began(seed):
    true = delays(400)
    linear = entangled(true, seed)
    rough, sd = linear.posterior(np.full(400, 0.018), np.full(400, 0.01))
    short = (true < 0.02).mean()
    near = MixtureLaw(np.array([0.01, 0.03]), np.full(2, 0.002), np.array([short, 1 - short]), true, sd)
    first, other = (mixture_law(linear, start, 2, np.random.default_rng(2)) for start in (rough, near))
    # About a hundredth of the standard errors, at least 0.002 / sqrt(200), that the law has from this many delays.
    assert first.means == pytest.approx(other.means, abs=2e-6)
    assert first.spreads == pytest.approx(other.spreads, rel=0.003)
    assert first.weights == pytest.approx(other.weights, abs=0.003)
    assert first.means == pytest.approx([0.01, 0.03], abs=5e-4)


def test_delays_given_their_components_have_the_posterior_of_the_normal_law():
    true = delays(60)
    linear = entangled(true)
    label = (true > 0.02).astype(int)
    means, spreads = np.array([0.01, 0.03]), np.array([0.002, 0.003])
    components = _Components(linear, label)
    one, centre, variance = components.draw(means, spreads, np.array([0.6, 0.4]), np.random.default_rng(0))
    drawn = one.argmax(1)
    expected = linear.posterior(means[drawn], spreads[drawn])
    assert centre == pytest.approx(expected[0], abs=1e-9)
    assert np.sqrt(variance) == pytest.approx(expected[1], rel=1e-6)


def test_components_are_drawn_as_often_as_their_likelihood_says():
    """Of two messages in one window: the four joint probabilities by the multivariate normal of scipy."""
    linear = entangled(np.array([0.01, 0.03]), each=2)
    means, spreads, weights = np.array([0.01, 0.03]), np.array([0.004, 0.004]), np.array([0.6, 0.4])
    a = linear.information[0] * 1e-4  # so that both components are likely
    h = linear.pull[0] * 1e-4
    linear = LinearDelays(linear.members, [a], [h])
    noise = np.linalg.inv(a)
    pairs = [(i, j) for i in (0, 1) for j in (0, 1)]
    density = [
        weights[[i, j]].prod()
        * multivariate_normal.pdf(noise @ h, means[[i, j]], np.diag(spreads[[i, j]] ** 2) + noise)  # pyright: ignore[reportArgumentType]
        for i, j in pairs
    ]
    components, generator = _Components(linear, np.zeros(2, dtype=int)), np.random.default_rng(1)
    drawn = [
        tuple(components.draw(means, spreads, weights, generator)[0].argmax(1).tolist()) for _ in range(4000)
    ]
    share = [drawn.count(pair) / len(drawn) for pair in pairs]
    assert share == pytest.approx(np.array(density) / sum(density), abs=0.03)
    assert min(share) > 0.01
