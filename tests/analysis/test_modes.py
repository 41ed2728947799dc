"""Modes: the linear dynamics taken apart without remainder."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.analysis.measures.modes import ModesError, find_modes
from deepkoco.koopman.latent_model import DenseTransition, JordanBlocks


def test_eigenvalues_of_jordan_blocks_are_told_per_second():
    blocks = JordanBlocks(np.exp((np.array([-0.5, 0.2]) + 1j * np.array([2.0, 5.0])) * 0.1))
    np.testing.assert_allclose(find_modes(blocks, 0.1).continuous, [-0.5 + 2j, 0.2 + 5j])


def test_one_step_multiplies_a_mode_by_its_eigenvalue():
    blocks = JordanBlocks(np.array([0.9 + 0.3j, 1.1 - 0.2j]))
    modes, latents = find_modes(blocks, 0.1), np.random.default_rng(1).normal(size=(5, 4))
    np.testing.assert_allclose(
        modes.coordinates(blocks.advance(latents)), modes.coordinates(latents) * modes.eigenvalues
    )


@given(st.integers(1, 7), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_the_readout_of_any_transition_is_the_sum_over_its_modes(size, rank, seed):
    generator = np.random.default_rng(seed)
    transition = DenseTransition(generator.normal(size=(size, size)))
    try:
        modes = find_modes(transition, 0.1)
    except ModesError:  # nearly defective; hardly ever drawn
        return
    latents, factors = generator.normal(size=(4, size)), generator.normal(size=(4, rank, size))
    expected = (factors @ latents[..., None])[..., 0]
    np.testing.assert_allclose(modes.split_readout(factors, latents).sum(-1), expected, rtol=1e-6, atol=1e-6)
    everything = modes.projection(np.ones(modes.eigenvalues.size, dtype=bool))
    np.testing.assert_allclose(everything, np.eye(size), atol=1e-6)


def test_a_dense_transition_has_the_modes_of_the_blocks_it_was_made_from():
    blocks = JordanBlocks(np.array([0.9 + 0.3j, 1.05 + 0.2j]))
    change = np.random.default_rng(2).normal(size=(4, 4))
    dense = DenseTransition(change @ blocks.matrix @ np.linalg.inv(change))
    np.testing.assert_allclose(find_modes(dense, 0.1).eigenvalues, [1.05 + 0.2j, 0.9 + 0.3j])  # slowest first


def test_a_transition_without_eigenvectors_is_refused():
    with pytest.raises(ModesError, match="no full set of eigenvectors"):
        find_modes(DenseTransition(np.array([[1.0, 1.0], [0.0, 1.0]])), 0.1)
