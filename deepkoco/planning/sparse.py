"""The sparse form: latents, actions and increments as variables, a larger QP with few entries."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from deepkoco.planning.config import Array, PlanningProblem
from deepkoco.planning.program import shifted
from deepkoco.planning.solvers import make_sparse_solver


class SparseProgram:
    r"""min of $\sum_{k=1}^H |y_k|^2 + R |a_k|^2 + \tilde R |\Delta a_{k-1}|^2$ s.t. the dynamics.

    Variables are $s_1 \dots s_H$, $y_1 \dots y_H$, $a_1 \dots a_H$ and $\Delta a_0 \dots \Delta a_{H-1}$. The
    auxiliary $y_k = C_k s_k$ keeps the Hessian diagonal; $|C_k s_k|^2$ written out would make it a dense block
    of $C_k^\top C_k$ per step. Only the entries of B and C and the right-hand side of the first steps change,
    in a fixed pattern.

    Attributes:
        refined: False; see `Program.refined`.

    Source: DeepKoCo, Eq. 5.16.
    """

    refined = False

    def __init__(
        self, problem: PlanningProblem, solver: str, tolerance: float, warm_start: str = "kept"
    ) -> None:
        """Set up the solver on the fixed pattern.

        Args:
            problem: Dynamics, weights and limits.
            solver: Name of the solver.
            tolerance: Absolute and relative tolerance of updated solvers.
            warm_start: "kept", "shifted" or "none", see `PlannerConfig`.

        Raises:
            UnknownSolverError: No such solver is installed, or it takes no sparse problem.
        """
        steps, actions, rank = problem.horizon, problem.action_low.size, problem.cost_rank
        latents = problem.dynamics.latent_size
        self._problem, self._warm_start = problem, warm_start
        self._dynamics = problem.dynamics.matrix
        sizes = np.array([steps * latents, steps * rank, steps * actions, steps * actions])
        ends = sizes.cumsum()
        self._parts = tuple(slice(int(e - s), int(e)) for s, e in zip(sizes, ends, strict=True))

        # The real part of an entry is its value and the imaginary part of a changing one its number, counted
        # from 1, in the flat vector (B_0 .. B_{H-1}, C_1 .. C_H): after the blocks are put together the
        # numbers tell where each entry went.
        count_b = steps * actions * latents
        numbers = -1.0 + 1j * np.arange(1, 1 + count_b + steps * rank * latents)
        b = numbers[:count_b].reshape(steps, actions, latents).swapaxes(1, 2)
        c = numbers[count_b:].reshape(steps, rank, latents)
        eye, before = sparse.eye_array(steps), sparse.csc_matrix(np.eye(steps, k=-1))
        matrix = sparse.csc_matrix(
            sparse.block_array(
                [
                    [
                        sparse.eye_array(steps * latents)
                        - sparse.kron(before, sparse.csc_matrix(self._dynamics)),
                        None,
                        None,
                        sparse.block_diag(list(b)),
                    ],
                    [sparse.block_diag(list(c)), sparse.eye_array(steps * rank), None, None],
                    [
                        None,
                        None,
                        sparse.kron(eye - before, np.eye(actions)),
                        -sparse.eye_array(steps * actions),
                    ],
                ]
            )
        )
        matrix.sort_indices()
        data = np.asarray(matrix.data)
        number = data.imag.astype(np.int64)
        matrix = sparse.csc_matrix((data.real, matrix.indices, matrix.indptr), (int(ends[2]), int(ends[3])))
        self._changing = np.flatnonzero(number)
        self._source = number[self._changing] - 1
        self._entries = data.real.astype(np.float64)
        self._right = np.zeros(int(ends[2]))

        weights: Array = np.repeat([0.0, 1.0, 0.0, 0.0], sizes)
        weights[self._parts[2]], weights[self._parts[3]] = problem.action_weights, problem.increment_weights
        low, high = np.full(int(ends[3]), -np.inf), np.full(int(ends[3]), np.inf)
        low[self._parts[2]] = np.tile(problem.action_low, steps)
        high[self._parts[2]] = np.tile(problem.action_high, steps)
        self._solver = make_sparse_solver(solver, 2.0 * weights, matrix, low, high, tolerance)
        self._solution: Array | None = None

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        return self._solver.iterations

    def reset(self) -> None:
        """See `Program.reset`."""
        self._solution = None
        self._solver.restart()

    def solve(self, rows: Array, factor: Array, action: Array) -> Array:
        """See `Program.solve`."""
        steps = self._problem.horizon
        inputs = np.broadcast_to(rows[1:], (steps, *rows[1:].shape))
        return self.solve_varying(rows[0], inputs, np.broadcast_to(factor, (steps, *factor.shape)), action)

    def solve_varying(
        self, latent: Array, inputs: Array, factors: Array, action: Array, offsets: Array | None = None
    ) -> Array:
        """See `VaryingProgram.solve_varying`."""
        self._entries[self._changing] = -np.concatenate((inputs.ravel(), factors.ravel()))[self._source]
        self._right[: latent.size] = self._dynamics @ latent
        self._right[self._parts[1]] = 0.0 if offsets is None else offsets.ravel()
        self._right[self._parts[2].start : self._parts[2].start + action.size] = action
        if self._warm_start == "none":
            self._solver.restart()
        elif self._warm_start == "shifted" and self._solution is not None:
            moved = [shifted(self._of(part)).ravel() for part in range(4)]
            moved[3][-action.size :] = 0.0
            self._solver.start_at(np.concatenate(moved))
        self._solution = self._solver.solve(self._entries, self._right)
        return self._of(2)

    def planned_cost(self, planned: Array) -> float:
        """See `Program.planned_cost`; y is that of the last solution, whatever the plan."""
        assert self._solution is not None
        y, flat = self._solution[self._parts[1]], planned.ravel()
        return float(y @ y + self._problem.action_weights * flat @ flat)

    def conditioning(self) -> float:
        """NaN: the Hessian is singular by design, as it has no entries for the latents."""
        return float("nan")

    def _of(self, part: int) -> Array:
        """One kind of variable of the last solution, by step (H, ...)."""
        assert self._solution is not None
        return self._solution[self._parts[part]].reshape(self._problem.horizon, -1)
