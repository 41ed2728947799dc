"""Planning with B_k and C_k taken anew along the last plan."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deepkoco.koopman.latent_model import LatentDynamics, LatentModel
from deepkoco.planning.config import Array
from deepkoco.planning.errors import SolverError
from deepkoco.planning.program import VaryingProgram, check_decoder, shifted

FIRST_PASSES = 3
"""Solves at the first step of an episode, which has no last plan."""
TANGENT_STEP = 1e-6
"""Step of the difference quotients; psi is piecewise affine, so y(s) is a parabola between its kinks."""
Relinearise = Callable[[Array, Array, Array], tuple[Array, Array, Array | None]]
"""From latents s_1 .. s_H (H, n), actions a_1 .. a_H (H, M) and the present B (M, n) to the columns of B_1 .. B_H as
rows (H, M, n), C_1 .. C_H (H, r, n) and offsets e_1 .. e_H (H, r) of y_k = C_k s_k + e_k, None for zero."""


def relinearise_cost(model: LatentModel) -> Relinearise:
    """C at the predicted latents, B of the present state."""

    def relinearise(latents: Array, actions: Array, present: Array) -> tuple[Array, Array, None]:
        return np.broadcast_to(present, (len(latents), *present.shape)), model.factor(latents), None

    return relinearise


def relinearise_all(model: LatentModel) -> Relinearise:
    """B and C at the predicted latents; raises `PlannerConfigError` for a model without decoder."""
    decodable = check_decoder(model)

    def relinearise(latents: Array, actions: Array, present: Array) -> tuple[Array, Array, None]:
        return *decodable.linearise_along(latents, actions), None

    return relinearise


def relinearise_tangent(model: LatentModel) -> Relinearise:
    r"""B at the predicted latents and the tangent of $y(s) = \psi(s) s$ there.

    $\psi(\bar s)$ alone gives the value of y but not its slope, which is $\psi(\bar s) + \bar s^\top \psi'(\bar
    s)$. B is piecewise constant (the networks are ReLU), so this is the Gauss-Newton step on the model
    of updated rollouts. Raises `PlannerConfigError` for a model without decoder.
    """
    decodable = check_decoder(model)
    step = TANGENT_STEP * np.eye(model.dynamics.latent_size)

    def relinearise(latents: Array, actions: Array, present: Array) -> tuple[Array, Array, Array]:
        inputs, factors = decodable.linearise_along(latents, actions)
        y = (factors @ latents[..., None])[..., 0]  # (H, r)
        beside = latents[:, None] + step  # (H, n, n)
        moved = (model.factor(beside) @ beside[..., None])[..., 0]  # (H, n, r)
        slope = np.ascontiguousarray(((moved - y[:, None]) / TANGENT_STEP).swapaxes(1, 2))
        return inputs, slope, y - (slope @ latents[..., None])[..., 0]

    return relinearise


class AlongPlan:
    r"""$s_{k+1} = A s_k + B_k \Delta a_k$, $y_k = C_k s_k$ along the last plan, one quadratic program per step.

    The last plan, moved on by one step and run from the present latent, gives nominal latents and actions
    $(\bar s_k, \bar a_k)$; there $B_k = \partial\varphi/\partial a$ at $(\varphi^{-1}(\bar s_k), \bar
    a_k)$ and $C_k = \psi(\bar s_k)$. The first step of an episode starts from the free motion, which
    needs no B, and solves a few times. B may also stay that of the present state (`relinearise_cost`).
    Frozen B and C are the same with $\bar s_k = s_0$ and $\bar a_k = a_0$.

    Source: the scheme of quasi-linear parameter-varying MPC: Cisneros, Voss and Werner, Efficient nonlinear
    model predictive control via quasi-LPV representation, CDC 2016.
    """

    def __init__(
        self, dynamics: LatentDynamics, relinearise: Relinearise, program: VaryingProgram, horizon: int
    ) -> None:
        """Keep the parts.

        Args:
            dynamics: A of the free motion.
            relinearise: Gives B_k and C_k at nominal points.
            program: Solves the quadratic program.
            horizon: H.
        """
        self._dynamics, self._relinearise = dynamics, relinearise
        self._program, self._horizon = program, horizon
        self._planned: Array | None = None
        self._inputs = np.zeros(0)

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        return self._program.iterations

    @property
    def refined(self) -> bool:
        """See `Program.refined`; of the last pass."""
        return self._program.refined

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
                following, factors, offsets = self._relinearise(latents, nominal, rows[1:])
            inputs = np.concatenate((rows[None, 1:], following[:-1]))
            nominal = self._program.solve_varying(rows[0], inputs, factors, action, offsets)
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
