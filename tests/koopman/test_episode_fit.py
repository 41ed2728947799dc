"""EDMDc fitted to recorded episodes: its features."""

import numpy as np

from deepkoco.koopman.lifting.episode_fit import COMPONENTS, ScaledRadialBasis


def test_the_unit_of_an_entry_does_not_change_the_features():
    generator = np.random.default_rng(0)
    observations = generator.normal(size=(50, 3))
    scales = np.array([1.0, 1000.0, 0.01])
    one = ScaledRadialBasis(observations, 5, np.random.default_rng(1))
    other = ScaledRadialBasis(observations * scales, 5, np.random.default_rng(1))
    np.testing.assert_allclose(one(observations), other(observations * scales), rtol=1e-9, atol=1e-12)


def test_many_entries_are_reduced_to_their_leading_components():
    generator = np.random.default_rng(0)
    observations = generator.normal(size=(300, 60)) @ generator.normal(size=(60, 60))
    basis = ScaledRadialBasis(observations, 5, generator)
    assert basis.size == COMPONENTS + 5
    assert basis.observation_size == 60
    assert basis(observations).shape == (300, COMPONENTS + 5)
