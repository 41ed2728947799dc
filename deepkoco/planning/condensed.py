"""The condensed form: the latents eliminated, a small dense QP in the actions."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import as_strided

from deepkoco.planning.box_program import BoxProgram
from deepkoco.planning.config import Array, PlanningProblem


class CondensedProgram(BoxProgram):
    r"""$y = y_0 + D a$ with B and C frozen over the plan.

    $y_k = C s_k = C A^k s_0 + \sum_{j<k} g_{k-1-j} \Delta a_j$ with $g_i = C A^i B$, so in the actions $D$ is
    the Toeplitz matrix $D_{ki} = g_{k-i} - g_{k-i-1}$. `BoxProgram` states the rest.

    Source: DeepKoCo, Eq. 5.16.
    """

    def __init__(
        self, problem: PlanningProblem, solver: str, tolerance: float, warm_start: str = "kept"
    ) -> None:
        """Prepare the powers of A and the Toeplitz matrix; see `BoxProgram`."""
        steps, actions, rank = problem.horizon, problem.action_low.size, problem.cost_rank
        super().__init__(problem, solver, tolerance, warm_start)
        self._shape = (rank * steps, steps * actions)
        self._steps = steps
        self._respond = problem.dynamics.responses(steps)
        self._coefficients = np.zeros((rank, 2 * steps - 1, actions))
        stride = self._coefficients.strides
        self._toeplitz = as_strided(
            self._coefficients[:, steps - 1 :],
            (rank, steps, steps, actions),
            (stride[0], stride[1], -stride[1], stride[2]),
            writeable=False,
        )

    def response(self, rows: Array, factor: Array, action: Array) -> tuple[Array, Array]:
        """How y = (C s_1 .. C s_H) depends on the actions; rows, factor and action as in `Program.solve`.

        Returns:
            D (r H, H M) and y_0 (r H,).
        """
        steps, coefficients = self._steps, self._coefficients
        response = self._respond(rows, factor)  # (r, 1 + M, H + 1)
        impulse = response[:, 1:, :steps].swapaxes(1, 2)  # (r, H, M)
        free = response[:, 0, 1:] - impulse @ action  # (r, H)
        coefficients[:, steps - 1 :] = impulse
        coefficients[:, steps:] -= impulse[:, :-1]
        return self._toeplitz.reshape(self._shape), free.ravel()

    def matrices(self, rows: Array, factor: Array, action: Array) -> tuple[Array, Array]:
        """The quadratic program at one state; rows, factor and action as in `Program.solve`.

        Returns:
            Hessian (HM, HM) and gradient (HM,) for the stacked actions a_1 .. a_H.
        """
        return self.quadratic(*self.response(rows, factor, action), action)

    def solve(self, rows: Array, factor: Array, action: Array) -> Array:
        """See `Program.solve`."""
        return self.solve_box(*self.response(rows, factor, action), action)


class VaryingCondensedProgram(BoxProgram):
    r"""$y = y_0 + D a$ with B_k and C_k of their own at every step.

    $y_k = C_k A^k s_0 + \sum_{j<k} G_{kj} \Delta a_j$ with $G_{kj} = C_k A^{k-1-j} B_j$, so $D_{ki} = G_{k,i-1} -
    G_{ki}$. The columns of every B_j are moved on step by step, together with the latent.
    """

    def response(self, latent: Array, inputs: Array, factors: Array, action: Array) -> tuple[Array, Array]:
        """How y = (C_1 s_1 .. C_H s_H) depends on the actions; arguments as in `VaryingProgram.solve_varying`.

        Returns:
            D (H r, H M) and y_0 (H r,).
        """
        steps, actions, size = inputs.shape
        moved = np.empty((1 + steps * actions, size))
        moved[0] = latent
        response = np.zeros((steps, factors.shape[1], 1 + steps * actions))
        for k in range(steps):
            known = 1 + k * actions
            moved[:known] = self._problem.dynamics.advance(moved[:known])
            moved[known : known + actions] = inputs[k]
            response[k, :, : known + actions] = factors[k] @ moved[: known + actions].T
        response = response.reshape(-1, 1 + steps * actions)
        free, matrix = response[:, 0], response[:, 1:]
        free = free - matrix[:, :actions] @ action
        matrix[:, :-actions] -= matrix[:, actions:]
        return matrix, free

    def solve_varying(
        self, latent: Array, inputs: Array, factors: Array, action: Array, offsets: Array | None = None
    ) -> Array:
        """See `VaryingProgram.solve_varying`."""
        matrix, free = self.response(latent, inputs, factors, action)
        if offsets is not None:
            free = free + offsets.ravel()
        return self.solve_box(matrix, free, action)
