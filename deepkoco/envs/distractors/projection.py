"""A random projection of all entries of the observation."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.stats import special_ortho_group

_STREAM = 7907


def random_rotation(size: int, fraction: float, seed: int) -> np.ndarray:
    """A random rotation, or the way to it: orthogonal, so of full rank, whatever the fraction.

    With Q uniform over the rotations, Q = expm(A) with A skew-symmetric, this is expm(fraction A).

    Args:
        size: Entries N.
        fraction: 0 (the identity) to 1 (Q).
        seed: Of Q: one per run, the same in training and evaluation, for a policy belongs to one Q.

    Returns:
        (N, N) float32.
    """
    if fraction == 0.0 or size == 1:
        return np.eye(size, dtype=np.float32)
    generator = np.random.default_rng([_STREAM, seed])
    rotation = special_ortho_group.rvs(size, random_state=generator)
    return expm(fraction * skew_logarithm(rotation)).astype(np.float32)


def skew_logarithm(rotation: np.ndarray) -> np.ndarray:
    """Principal logarithm of a rotation (N, N), real and skew-symmetric.

    A rotation is normal, so its eigenvectors are orthonormal and its logarithm follows from its angles;
    the general logarithm of scipy loses digits where an angle is near pi.
    """
    values, vectors = np.linalg.eig(rotation)
    angles = np.angle(values)
    logarithm = ((vectors * (1j * angles)) @ np.linalg.inv(vectors)).real
    return (logarithm - logarithm.T) / 2.0
