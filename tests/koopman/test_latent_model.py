"""The two kinds of latent dynamics against plain matrix algebra."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag, expm

from deepkoco.koopman.latent_model import DenseTransition, JordanBlocks


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**20), pairs=st.integers(1, 4))
def test_jordan_blocks_are_the_matrix_exponential_of_their_generator(seed, pairs):
    rng = np.random.default_rng(seed)
    mu, omega = rng.normal(size=pairs), rng.uniform(0.0, 6.0, pairs)
    generator = block_diag(*(np.array([[m, -w], [w, m]]) for m, w in zip(mu, omega, strict=True)))
    dynamics = JordanBlocks(np.exp((mu + 1j * omega) * 0.05))
    np.testing.assert_allclose(dynamics.matrix, expm(generator * 0.05), atol=1e-13)
    latents = rng.normal(size=(3, 2 * pairs))
    np.testing.assert_allclose(dynamics.advance(latents), latents @ dynamics.matrix.T, atol=1e-13)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**20), rank=st.integers(1, 3), count=st.integers(1, 3))
def test_responses_are_products_with_powers_of_the_matrix(seed, rank, count):
    rng = np.random.default_rng(seed)
    jordan = JordanBlocks(rng.uniform(0.8, 1.1, 2) * np.exp(1j * rng.uniform(0, 3, 2)))
    rows, factor = rng.normal(size=(count, 4)), rng.normal(size=(rank, 4))
    for dynamics in (jordan, DenseTransition(rng.normal(size=(4, 4)))):
        powers = [np.linalg.matrix_power(dynamics.matrix, k) for k in range(6)]
        expected = np.stack([factor @ power @ rows.T for power in powers], axis=-1)
        np.testing.assert_allclose(dynamics.responses(5)(rows, factor), expected, atol=1e-10)
