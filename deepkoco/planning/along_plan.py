"""Planning with B_k and C_k taken anew along the last plan."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from deepkoco.koopman.latent_model import LatentModel
from deepkoco.planning.config import Array
from deepkoco.planning.errors import PlannerConfigError, SolverError
from deepkoco.planning.program import VaryingProgram, shifted

FIRST_PASSES = 3
"""Solves at the first step of an episode, which has no last plan."""


@runtime_checkable
class DecodableModel(Protocol):
    """A latent model that can be linearised at a predicted latent."""

    def linearise_along(self, latents: Array, actions: Array) -> tuple[Array, Array]:
        """Columns of B_k as rows (..., M, n) and C_k (..., r, n) at latents (..., n) and actions (..., M)."""
        ...


class AlongPlan:
    r"""$s_{k+1} = A s_k + B_k \Delta a_k$, $y_k = C_k s_k$ along the last plan, one quadratic program per step.

    The last plan, moved on by one step and run from the present latent, gives nominal latents and actions
    $(\bar s_k, \bar a_k)$; there $B_k = \partial\varphi/\partial a$ at $(\varphi^{-1}(\bar s_k), \bar a_k)$ and $C_k =
    \psi(\bar s_k)$. The first step of an episode starts from the free motion, which needs no B, and solves
    a few times. Frozen B and C are the same with $\bar s_k = s_0$ and $\bar a_k = a_0$.

    Source: the scheme of quasi-linear parameter-varying MPC: Cisneros, Voss and Werner, Efficient nonlinear
    model predictive control via quasi-LPV representation, CDC 2016.
    """

    def __init__(self, model: LatentModel, program: VaryingProgram, horizon: int) -> None:
        """Check the model.

        Args:
            model: A latent model with a decoder.
            program: Solves the quadratic program.
            horizon: H.

        Raises:
            PlannerConfigError: The model has no decoder.
        """
        reason = "it cannot be linearised at predicted latents"
        if isinstance(model, DecodableModel):
            try:
                model.linearise_along(np.zeros(model.dynamics.latent_size), np.zeros(model.action_size))
                reason = ""
            except ValueError as error:
                reason = str(error)
        if reason:
            raise PlannerConfigError(
                f'planner.linearisation = "along_plan" does not go with this model: {reason}; '
                'or give planner.linearisation="frozen"'
            )
        assert isinstance(model, DecodableModel)
        self._model, self._dynamics = model, model.dynamics
        self._program, self._horizon = program, horizon
        self._planned: Array | None = None
        self._inputs = np.zeros(0)

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        return self._program.iterations

    def reset(self) -> None:
        """See `Program.reset`."""
        self._planned = None
        self._program.reset()

    def solve(self, rows: Array, factor: Array, action: Array) -> Array:
        """See `Program.solve`; the factor at the present state is not used, as c_0 is no decision."""
        if self._planned is None:
            nominal, inputs = np.tile(action, (self._horizon, 1)), np.tile(rows[1:], (self._horizon, 1, 1))
            passes = FIRST_PASSES
        else:
            nominal, inputs, passes = shifted(self._planned), shifted(self._inputs), 1
        self._planned = None  # a step that is not solved leaves no plan to go on from
        for _ in range(passes):
            inputs[0] = rows[1:]
            latents = self._roll(rows[0], inputs, nominal, action)
            with np.errstate(over="ignore", invalid="ignore"):
                following, factors = self._model.linearise_along(latents, nominal)
            inputs = np.concatenate((rows[None, 1:], following[:-1]))
            nominal = self._program.solve_varying(rows[0], inputs, factors, action)
        if not np.isfinite(nominal).all():
            raise SolverError("the plan is not finite")
        self._planned, self._inputs = nominal, inputs
        return nominal

    def planned_cost(self, planned: Array) -> float:
        """See `Program.planned_cost`."""
        return self._program.planned_cost(planned)

    def conditioning(self) -> float:
        """See `Program.conditioning`."""
        return self._program.conditioning()

    def _roll(self, latent: Array, inputs: Array, planned: Array, action: Array) -> Array:
        """Predicted s_1 .. s_H (H, n) of a plan a_1 .. a_H (H, M)."""
        increments = np.diff(planned, axis=0, prepend=action[None])
        forced = (increments[:, None] @ inputs)[:, 0]  # (H, n)
        latents = np.empty_like(forced)
        for k in range(self._horizon):
            latent = self._dynamics.advance(latent) + forced[k]
            latents[k] = latent
        return latents
