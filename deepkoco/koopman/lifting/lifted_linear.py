"""A model that is linear in lifted observations and in the action, as a latent model for the planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deepkoco.koopman.latent_model import DenseTransition
from deepkoco.koopman.lifting.lifting import Array, Lifting, StackedHistory


class LiftedModelError(ValueError):
    """Matrices of a lifted linear model do not fit each other."""


@dataclass(frozen=True)
class LiftedCost:
    r"""$c = |F z + f|^2 + a^\top R a$, a square in the lifted observation.

    Attributes:
        factor: F (r, p).
        offset: f (r,).
        action_weight: R, one for all actions or one each (M,).
    """

    factor: Array
    offset: Array
    action_weight: float | Array

    def __call__(self, lifted: Array, actions: Array) -> Array:
        """The cost (...,) of z (..., p) and a (..., M)."""
        roots = lifted @ self.factor.T + self.offset
        return np.square(roots).sum(-1) + (self.action_weight * np.square(actions)).sum(-1)


def target_cost(output: ArrayLike, weights: ArrayLike, target: ArrayLike, action_weight: float) -> LiftedCost:
    r"""The cost $(o - o^*)^\top Q (o - o^*) + R a^\top a$ with observations $o = C z$.

    Args:
        output: C (N, p), from lifted to plain observations.
        weights: Q, symmetric and positive semidefinite (N, N), or its diagonal (N,).
        target: o* (N,).
        action_weight: R, 0 or more.

    Returns:
        The cost with as many rows as Q has rank.

    Raises:
        LiftedModelError: Shapes do not fit, or Q is not positive semidefinite.
    """
    output = np.asarray(output, np.float64)
    target = np.asarray(target, np.float64)
    weights = np.asarray(weights, np.float64)
    weights = np.diag(weights) if weights.ndim == 1 else weights
    size = output.shape[0]
    if weights.shape != (size, size) or target.shape != (size,):
        raise LiftedModelError(
            f"weights {weights.shape} and target {target.shape} do not fit {size} observed entries"
        )
    if not np.allclose(weights, weights.T):
        raise LiftedModelError("the weights of the observations are not symmetric; give (Q + Q') / 2")
    values, vectors = np.linalg.eigh(weights)
    smallest = 1e-12 * max(1.0, float(np.abs(values).max()))
    if values[0] < -smallest:
        raise LiftedModelError(
            f"the weights of the observations have the negative eigenvalue {values[0]:.3g}; costs are squares"
        )
    kept = values > smallest
    if not kept.any():
        raise LiftedModelError("the weights of the observations are all zero; nothing is to be controlled")
    root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T  # root' root = Q
    return LiftedCost(root @ output, -root @ target, float(action_weight))


class LiftedLinearModel:
    r"""$z_{k+1} = A z_k + B a_k$ with $z = g(o)$, written in action increments.

    The latent is $s = (z, a, 1)$: the action belongs to it because the planner moves it by increments, and the
    1 carries the target of the cost,

    $s_{k+1} = \begin{pmatrix} A & B & 0 \\ 0 & I & 0 \\ 0 & 0 & 1 \end{pmatrix} s_k +
    \begin{pmatrix} 0 \\ I \\ 0 \end{pmatrix} \Delta a_k$, $C = (F, 0, f)$.

    As everywhere here, a_k acts from step k to k + 1 and the increment decided at k changes a_{k+1}. It is a
    `deepkoco.koopman.latent_model.LatentModel`; its observations are the lifting's stacked ones.
    """

    def __init__(
        self, lifting: Lifting, transition: ArrayLike, inputs: ArrayLike, cost: LiftedCost, time_step: float
    ) -> None:
        """Check and assemble.

        Args:
            lifting: g.
            transition: A (p, p).
            inputs: B (p, M).
            cost: Cost of z and a.
            time_step: Seconds per step.

        Raises:
            LiftedModelError: Shapes do not fit, or a number is not finite.
        """
        self.lifting, self.cost, self.time_step = lifting, cost, float(time_step)
        self.transition = np.asarray(transition, np.float64)
        self.inputs = np.asarray(inputs, np.float64)
        p = lifting.size
        if self.transition.shape != (p, p):
            raise LiftedModelError(f"A has shape {self.transition.shape}; the lifting gives {p} entries")
        if self.inputs.ndim != 2 or self.inputs.shape[0] != p or self.inputs.shape[1] == 0:
            raise LiftedModelError(f"B has shape {self.inputs.shape}; give ({p}, actions)")
        rank = len(cost.offset)
        if rank == 0 or cost.factor.shape != (rank, p) or cost.offset.shape != (rank,):
            raise LiftedModelError(
                f"the cost's factor {cost.factor.shape} and offset {cost.offset.shape} do not fit {p} entries"
            )
        numbers = (self.transition, self.inputs, cost.factor, cost.offset)
        if not all(np.isfinite(array).all() for array in numbers):
            raise LiftedModelError("A, B or the cost holds numbers that are not finite")
        weights = np.asarray(cost.action_weight)
        if weights.shape not in ((), (self.action_size,)):
            raise LiftedModelError(
                f"action_weight has shape {weights.shape}; give one, or ({self.action_size},)"
            )
        if not 0 < self.time_step < np.inf or not ((weights >= 0) & np.isfinite(weights)).all():
            raise LiftedModelError(
                f"time_step = {time_step} and action_weight = {cost.action_weight}; "
                "give a time above 0 and a weight of 0 or more"
            )
        m = self.action_size
        matrix = np.eye(p + m + 1)
        matrix[:p, :p], matrix[:p, p : p + m] = self.transition, self.inputs
        self._dynamics = DenseTransition(matrix)
        self._columns = np.zeros((m, p + m + 1))
        self._columns[:, p : p + m] = np.eye(m)
        self._factor = np.hstack((cost.factor, np.zeros((rank, m)), cost.offset[:, None]))

    @property
    def observation_size(self) -> int:
        """window * N, entries of the stacked observations."""
        return self.lifting.window * self.lifting.observation_size

    def make_history(self) -> StackedHistory | None:
        """The history of observations of one environment; None for a lifting of the present one."""
        if self.lifting.window == 1:
            return None
        return StackedHistory(self.lifting.observation_size, self.lifting.window)

    @property
    def action_size(self) -> int:
        """M."""
        return self.inputs.shape[1]

    @property
    def cost_rank(self) -> int:
        """r."""
        return len(self.cost.offset)

    @property
    def action_weight(self) -> float | Array:
        """R, one for all actions or one each (M,)."""
        return self.cost.action_weight

    @property
    def dynamics(self) -> DenseTransition:
        """Free motion of s = (z, a, 1) over one step."""
        return self._dynamics

    def linearise(self, observation: Array, action: Array) -> tuple[Array, Array]:
        """Latent, input columns and cost factor; see `LatentModel`."""
        lifted = self.lifting(observation)
        rows = np.empty((*lifted.shape[:-1], 1 + self.action_size, self._dynamics.latent_size))
        rows[..., 0, : lifted.shape[-1]] = lifted
        rows[..., 0, lifted.shape[-1] : -1] = action
        rows[..., 0, -1] = 1.0
        rows[..., 1:, :] = self._columns
        return rows, self.factor(rows[..., 0, :])

    def factor(self, latent: Array) -> Array:
        """Cost factor C (..., r, p + M + 1), the same at every latent."""
        return np.ascontiguousarray(np.broadcast_to(self._factor, (*latent.shape[:-1], *self._factor.shape)))
