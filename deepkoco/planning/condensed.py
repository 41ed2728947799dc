"""The LMPC problem with the latents eliminated: a small dense QP in the actions."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import as_strided

from deepkoco.planning.backends import make_box_solver
from deepkoco.planning.config import Array, PlanningProblem


class CondensedProgram:
    r"""min over $a_{min} \le a_1 \dots a_H \le a_{max}$ of $\sum |y|^2 + R a^2 + \tilde R \sum \Delta a^2$.

    With B and C frozen, $y_k = C s_k = C A^k s_0 + \sum_{j<k} g_{k-1-j} \Delta a_j$ and $g_i = C A^i B$.
    Written in the actions instead of the increments the limits are plain bounds and $y = y_0 + D a$ with the
    Toeplitz matrix $D_{ki} = g_{k-i} - g_{k-i-1}$; the two programs are one linear change of variables apart.

    Source: DeepKoCo, Eq. 5.16.
    """

    def __init__(self, problem: PlanningProblem, solver: str, tolerance: float) -> None:
        """Make everything that does not change from step to step.

        Args:
            problem: Dynamics, weights and limits.
            solver: Name of the backend.
            tolerance: For backends that iterate.

        Raises:
            UnknownSolverError: No such solver is installed.
        """
        steps, actions = problem.horizon, problem.action_low.size
        self._increment_weight = problem.increment_weight
        self._shape = (problem.cost_rank, steps, actions)
        self._respond = problem.dynamics.responses(steps)
        difference = np.eye(steps) - np.eye(steps, k=-1)
        fixed = problem.action_weight * np.eye(steps) + problem.increment_weight * difference.T @ difference
        self._fixed = 2.0 * np.kron(fixed, np.eye(actions))
        self._coefficients = np.zeros((problem.cost_rank, 2 * steps - 1, actions))
        rank, row, column = self._coefficients.strides
        self._toeplitz = as_strided(
            self._coefficients[:, steps - 1 :],
            (problem.cost_rank, steps, steps, actions),
            (rank, row, -row, column),
            writeable=False,
        )
        low, high = np.tile(problem.action_low, steps), np.tile(problem.action_high, steps)
        self._solver = make_box_solver(solver, low, high, tolerance)

    def matrices(self, rows: Array, factor: Array, action: Array) -> tuple[Array, Array]:
        """The quadratic program at one state.

        Args:
            rows: Latent and input columns (1 + M, n) as given by `LatentModel.linearise`.
            factor: Cost factor C (r, n).
            action: Present action a_0 (M,).

        Returns:
            Hessian (HM, HM) and gradient (HM,) for the stacked actions a_1 .. a_H.
        """
        rank, steps, actions = self._shape
        response = self._respond(rows, factor)  # (r, 1 + M, H + 1)
        impulse = response[:, 1:, :steps].swapaxes(1, 2)  # (r, H, M)
        free = response[:, 0, 1:] - impulse @ action  # (r, H)
        coefficients = self._coefficients
        coefficients[:, steps - 1 :] = impulse
        coefficients[:, steps:] -= impulse[:, :-1]
        matrix = self._toeplitz.reshape(rank * steps, steps * actions)
        hessian = 2.0 * (matrix.T @ matrix)
        hessian += self._fixed
        gradient = 2.0 * (free.ravel() @ matrix)
        gradient[:actions] -= 2.0 * self._increment_weight * action
        return hessian, gradient

    def solve(self, rows: Array, factor: Array, action: Array) -> Array:
        """Plan.

        Args:
            rows: See `matrices`.
            factor: See `matrices`.
            action: See `matrices`.

        Returns:
            Planned actions a_1 .. a_H (H, M).

        Raises:
            SolverError: The program was not solved.
        """
        return self._solver.solve(*self.matrices(rows, factor, action)).reshape(self._shape[1:])
