"""The LMPC problem with latents, actions and increments as variables: a larger, sparse QP."""

from __future__ import annotations

import numpy as np
import osqp
from scipy import sparse

from deepkoco.planning.backends import check_entries, osqp_solution
from deepkoco.planning.config import Array, PlanningProblem


class SparseProgram:
    r"""min of $\sum_{k=1}^H |y_k|^2 + R |a_k|^2 + \tilde R |\Delta a_{k-1}|^2$ s.t. the dynamics.

    Variables are $s_1 \dots s_H$, $y_1 \dots y_H$, $a_1 \dots a_H$ and $\Delta a_0 \dots \Delta a_{H-1}$.
    The auxiliary $y_k = C s_k$ keeps the Hessian diagonal; $|C s_k|^2$ written out would make it a dense
    block of $C^\top C$ per step. Only the entries of B and C and the right-hand side of the first steps
    change, in a fixed pattern.

    Source: DeepKoCo, Eq. 5.16.
    """

    def __init__(self, problem: PlanningProblem, tolerance: float) -> None:
        """Set up OSQP on the fixed pattern.

        Args:
            problem: Dynamics, weights and limits.
            tolerance: Absolute and relative tolerance of OSQP.
        """
        steps, actions, rank = problem.horizon, problem.action_low.size, problem.cost_rank
        latents = problem.dynamics.latent_size
        self._shape = (steps, actions)
        self._dynamics = problem.dynamics.matrix
        sizes = np.array([steps * latents, steps * rank, steps * actions, steps * actions])
        s_at, y_at, a_at, da_at = np.concatenate(([0], sizes.cumsum()[:-1]))
        total = int(sizes.sum())

        eye, shift = sparse.identity(steps), sparse.csc_matrix(np.eye(steps, k=-1))
        ones_b, ones_c = np.ones((latents, actions)), np.ones((rank, latents))
        move = sparse.kron(eye, np.eye(latents)) - sparse.kron(shift, sparse.csc_matrix(self._dynamics))
        hold = sparse.kron(eye - shift, np.eye(actions))
        matrix = sparse.csc_matrix(
            sparse.block_array(
                [
                    [move, None, None, sparse.kron(eye, -ones_b)],
                    [sparse.kron(eye, -ones_c), sparse.identity(steps * rank), None, None],
                    [None, None, hold, -sparse.identity(steps * actions)],
                    [None, None, sparse.identity(steps * actions), None],
                ]
            )
        )
        matrix.sort_indices()
        columns = np.repeat(np.arange(total), np.diff(matrix.indptr))
        row_of = matrix.indices
        is_b = (columns >= da_at) & (row_of < s_at + sizes[0])
        is_c = (columns < y_at) & (row_of >= sizes[0])
        self._changing = np.flatnonzero(is_b | is_c)
        # Position of every changing entry in the flat vector (B, then C, row by row).
        b_source = (row_of % latents) * actions + (columns - da_at) % actions
        c_source = latents * (actions + (row_of - sizes[0]) % rank) + columns % latents
        self._source = np.where(is_b, b_source, c_source)[self._changing]
        self._changing = self._changing.astype(np.int32)

        weights = np.concatenate(
            (
                np.zeros(sizes[0]),
                np.ones(sizes[1]),
                np.full(sizes[2], problem.action_weight),
                np.full(sizes[3], problem.increment_weight),
            )
        )
        equalities = int(sizes[0] + sizes[1] + sizes[2])
        self._low = np.concatenate((np.zeros(equalities), np.tile(problem.action_low, steps)))
        self._high = np.concatenate((np.zeros(equalities), np.tile(problem.action_high, steps)))
        self._first_latent = slice(0, latents)
        self._first_action = slice(int(sizes[0] + sizes[1]), int(sizes[0] + sizes[1]) + actions)
        self._actions = slice(a_at, a_at + int(sizes[2]))
        self._solver = osqp.OSQP()
        self._solver.setup(
            sparse.csc_matrix(sparse.diags_array(2.0 * weights)),
            np.zeros(total),
            matrix,
            self._low,
            self._high,
            verbose=False,
            eps_abs=tolerance,
            eps_rel=tolerance,
            max_iter=20000,
        )

    def solve(self, rows: Array, factor: Array, action: Array) -> Array:
        """Plan.

        Args:
            rows: Latent and input columns (1 + M, n) as given by `LatentModel.linearise`.
            factor: Cost factor C (r, n).
            action: Present action a_0 (M,).

        Returns:
            Planned actions a_1 .. a_H (H, M).

        Raises:
            SolverError: The program was not solved.
        """
        entries = -np.concatenate((rows[1:].T.ravel(), factor.ravel()))
        start = self._dynamics @ rows[0]
        check_entries("osqp", entries, start, action)
        for bound in (self._low, self._high):
            bound[self._first_latent] = start
            bound[self._first_action] = action
        self._solver.update(Ax=entries[self._source], Ax_idx=self._changing, l=self._low, u=self._high)
        return osqp_solution(self._solver)[self._actions].reshape(self._shape)
