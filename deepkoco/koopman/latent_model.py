"""What a planner needs of a latent model, and the two ways its linear dynamics are given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from deepkoco.koopman.matrix_powers import MatrixPowers

Array = NDArray[np.float64]
Responses = Callable[[Array, Array], Array]
"""From rows (1 + M, n) and factor C (r, n) to C A^k w (r, 1 + M, steps + 1) for every row w."""


class LatentDynamics(Protocol):
    """The free motion of a latent, s' = A s."""

    @property
    def latent_size(self) -> int:
        """n, entries of the latent."""
        ...

    @property
    def matrix(self) -> Array:
        """A (n, n), real."""
        ...

    def advance(self, latents: Array) -> Array:
        """One step: A s for each latent (..., n)."""
        ...

    def advance_by(self, latents: Array, steps: Array) -> Array:
        """Any time instead of one step: A^d s.

        Args:
            latents: (K, n).
            steps: d (K,), each 0 or more, not only whole ones.

        Returns:
            (K, n).
        """
        ...

    def responses(self, steps: int) -> Responses:
        """Prepare the products C A^k w for k = 0 .. steps; see `Responses`."""
        ...


@dataclass(frozen=True)
class JordanBlocks:
    r"""A = diag of the real 2 x 2 Jordan blocks of complex eigenvalues; the latent holds (Re, Im) pairs.

    Attributes:
        eigenvalues: Discrete-time eigenvalues (P,), one of each conjugate pair; n = 2P.

    Source: DeepKoCo, Eq. 5.4.
    """

    eigenvalues: NDArray[np.complex128]

    @property
    def latent_size(self) -> int:
        """n = 2P."""
        return 2 * self.eigenvalues.size

    @property
    def matrix(self) -> Array:
        """A (2P, 2P)."""
        # Row i of advance(I) is A e_i, a column of A.
        return np.ascontiguousarray(self.advance(np.eye(self.latent_size)).T)

    def advance(self, latents: Array) -> Array:
        """One step for each latent (..., 2P)."""
        pairs = np.ascontiguousarray(latents).view(np.complex128)
        return (pairs * self.eigenvalues).view(np.float64)

    def advance_by(self, latents: Array, steps: Array) -> Array:
        """Any time: each pair is multiplied by lambda^d, with the frequency of least magnitude."""
        pairs = np.ascontiguousarray(latents).view(np.complex128)
        return (pairs * self.eigenvalues ** np.asarray(steps)[:, None]).view(np.float64)

    def responses(self, steps: int) -> Responses:
        """Prepare C A^k w; the powers of the eigenvalues are known beforehand, so it is one product."""
        powers = self.eigenvalues[:, None] ** np.arange(steps + 1)  # (P, steps + 1)
        # Re(lambda^k w) for w stored as (real, imaginary) pairs.
        table = np.stack((powers.real, -powers.imag), axis=1).reshape(-1, steps + 1)

        def respond(rows: Array, factor: Array) -> Array:
            weighted = factor.view(np.complex128).conj()[:, None] * rows.view(np.complex128)
            return weighted.view(np.float64) @ table

        return respond


@dataclass(frozen=True)
class DenseTransition:
    """A as any real matrix: imported models (EDMDc, DeepKoopman).

    Attributes:
        matrix: A (n, n), for one step.
    """

    matrix: Array

    @property
    def latent_size(self) -> int:
        """n."""
        return self.matrix.shape[0]

    def advance(self, latents: Array) -> Array:
        """One step for each latent (..., n)."""
        return latents @ self.matrix.T

    def advance_by(self, latents: Array, steps: Array) -> Array:
        """Any time, exact where A has a real logarithm; else linear between whole steps."""
        return np.stack([self._powers.power(d) @ w for d, w in zip(steps, latents, strict=True)])

    @cached_property
    def _powers(self) -> MatrixPowers:
        return MatrixPowers(self.matrix)

    def responses(self, steps: int) -> Responses:
        """Prepare C A^k w; the rows are moved on step by step, which needs no powers of A in memory."""
        matrix = np.ascontiguousarray(self.matrix.T)

        def respond(rows: Array, factor: Array) -> Array:
            moved = np.empty((steps + 1, *rows.shape))
            moved[0] = rows
            for k in range(steps):
                np.matmul(moved[k], matrix, out=moved[k + 1])
            return (moved @ factor.T).transpose(2, 1, 0)

        return respond


class ObservationHistory(Protocol):
    """The last observations of one environment, for a model that takes more than the present one."""

    @property
    def observation_shape(self) -> tuple[int, ...]:
        """Shape of one observation."""
        ...

    @property
    def observation_type(self) -> type[np.generic]:
        """Type of its entries."""
        ...

    def reset(self) -> None:
        """Forget all at the start of an episode; before the first observation there is only that one."""
        ...

    def push(self, observation: Any, /) -> Array:
        """Take in this step's observation and give what `LatentModel.linearise` takes (..., N)."""
        ...


class LatentModel(Protocol):
    """A latent model as the planner sees it: s' = A s + B da, a' = a + da, cost |C s|^2 + R a'a.

    A model whose dynamics take the action itself, z' = A z + B a, fits in with the latent s = (z, a): the
    action then is part of the latent, and its input columns are those of da.
    """

    @property
    def observation_size(self) -> int:
        """N, entries of an observation."""
        ...

    def make_history(self) -> ObservationHistory | None:
        """What keeps the last observations; None where the model takes the present one as it is."""
        ...

    @property
    def action_size(self) -> int:
        """M."""
        ...

    @property
    def cost_rank(self) -> int:
        """r, rows of the cost factor."""
        ...

    @property
    def action_weight(self) -> float | Array:
        """R, one for all actions or one each (M,)."""
        ...

    @property
    def time_step(self) -> float:
        """Seconds per step."""
        ...

    @property
    def dynamics(self) -> LatentDynamics:
        """A, for one step."""
        ...

    def linearise(self, observation: Array, action: Array) -> tuple[Array, Array]:
        """Latent, input matrix and cost factor at one point or a batch of points.

        Args:
            observation: (..., N).
            action: (..., M).

        Returns:
            Rows (..., 1 + M, n), C-contiguous: the latent s, then the M columns of B as rows; and the cost
            factor C (..., r, n), C-contiguous.
        """
        ...

    def factor(self, latent: Array) -> Array:
        """Cost factor C (..., r, n) at a latent (..., n)."""
        ...
