"""The modes of a latent model: its linear dynamics taken apart into independent complex numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepkoco.koopman.latent_model import Array, JordanBlocks, LatentDynamics

ComplexArray = NDArray[np.complex128]
WORST_CONDITION = 1e10


class ModesError(ValueError):
    """The dynamics cannot be taken apart into independent modes."""


@dataclass(frozen=True)
class Modes:
    r"""Each mode is a complex number $z_p$ that one step multiplies by $\lambda_p$; $s = \mathrm{Re}(V z)$.

    A conjugate pair of eigenvalues is one mode, the one with the frequency at or above zero; a real eigenvalue is
    a mode too. With $z = W s$ the linear readout splits without remainder: $C s = \sum_p \mathrm{Re}(C V_p z_p)$.

    Attributes:
        eigenvalues: Discrete-time eigenvalues lambda (P,).
        to_modes: W (P, n), complex.
        from_modes: V (n, P), complex, with the factor 2 of a pair in it.
        time_step: Seconds per step.
    """

    eigenvalues: ComplexArray
    to_modes: ComplexArray
    from_modes: ComplexArray
    time_step: float

    @property
    def continuous(self) -> ComplexArray:
        """mu + i omega = ln(lambda) / dt (P,) [1/s]; the frequency is the least one with that lambda."""
        return (np.log(self.eigenvalues) / self.time_step).astype(np.complex128)

    def coordinates(self, latents: Array) -> ComplexArray:
        """Mode coordinates z (..., P) of latents (..., n)."""
        return latents @ self.to_modes.T

    def split_readout(self, factors: Array, latents: Array) -> Array:
        """Parts of C s that come from each mode.

        Args:
            factors: C (..., r, n).
            latents: s (..., n).

        Returns:
            (..., r, P); the sum over the last axis is C s.
        """
        return ((factors @ self.from_modes) * self.coordinates(latents)[..., None, :]).real

    def projection(self, kept: NDArray[np.bool_]) -> Array:
        """Matrix (n, n) that leaves the kept modes (P,) of a latent and takes the others out."""
        return (self.from_modes[:, kept] @ self.to_modes[kept]).real


def find_modes(dynamics: LatentDynamics, time_step: float) -> Modes:
    """Take linear dynamics apart.

    Args:
        dynamics: Of the latent, with n entries.
        time_step: Seconds per step.

    Returns:
        The modes; for Jordan blocks in the order of the blocks, else the slowest to die out first.

    Raises:
        ModesError: A dense matrix has repeated eigenvalues with too few eigenvectors.
    """
    if isinstance(dynamics, JordanBlocks):
        pairs = dynamics.eigenvalues.size
        to_modes = np.zeros((pairs, 2 * pairs), np.complex128)
        to_modes[np.arange(pairs), 2 * np.arange(pairs)] = 1.0  # z = s_re + i s_im
        to_modes[np.arange(pairs), 2 * np.arange(pairs) + 1] = 1.0j
        return Modes(dynamics.eigenvalues, to_modes, to_modes.conj().T.copy(), time_step)
    found = np.linalg.eig(dynamics.matrix)
    eigenvalues, vectors = (np.asarray(part, np.complex128) for part in found)
    condition = float(np.linalg.cond(vectors))
    if not condition < WORST_CONDITION:
        raise ModesError(
            f"the transition matrix has no full set of eigenvectors (condition {condition:.2g}); "
            "modes of such a model are not defined"
        )
    inverse: ComplexArray = np.asarray(np.linalg.inv(vectors), np.complex128)
    pair = eigenvalues.imag > 1e-12
    chosen = np.flatnonzero(eigenvalues.imag >= -1e-12)
    chosen = chosen[np.argsort(-np.abs(eigenvalues[chosen]), kind="stable")]
    return Modes(
        eigenvalues[chosen], inverse[chosen], vectors[:, chosen] * np.where(pair[chosen], 2.0, 1.0), time_step
    )
