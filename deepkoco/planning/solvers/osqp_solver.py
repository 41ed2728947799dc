"""OSQP, an operator-splitting solver, updated in place and warm-started."""

from __future__ import annotations

from typing import Any

import numpy as np
import osqp
from scipy import sparse

from deepkoco.planning.errors import SolverError
from deepkoco.planning.solvers.interface import Array, SparseMatrix, check_entries

STEP = 0.1
"""rho at the start; OSQP adapts it by itself."""


class Workspace:
    """One OSQP problem of fixed pattern.

    Attributes:
        iterations: Of the last solve.
        solver: The OSQP object.
    """

    def __init__(
        self, hessian: SparseMatrix, matrix: SparseMatrix, low: Array, high: Array, **settings: Any
    ) -> None:
        """Set up min x'Px/2 subject to low <= A x <= high."""
        self.iterations = 0
        self._sizes = hessian.get_shape()[0], low.size
        self.solver = osqp.OSQP()
        self.solver.setup(
            hessian,
            np.zeros(self._sizes[0]),
            matrix,
            low,
            high,
            verbose=False,
            rho=STEP,
            max_iter=20000,
            **settings,
        )

    def solve(self) -> Array:
        """Run OSQP and take its solution.

        Returns:
            The solution vector.

        Raises:
            SolverError: OSQP reports anything but "solved".
        """
        result = self.solver.solve(raise_error=False)
        self.iterations = result.info.iter
        if result.info.status != "solved":
            raise SolverError(f"osqp: {result.info.status}")
        return np.asarray(result.x)

    def restart(self) -> None:
        """Forget the last solution and what was learned about the step size."""
        self.solver.update_settings(rho=STEP)
        self.solver.warm_start(x=np.zeros(self._sizes[0]), y=np.zeros(self._sizes[1]))


class OsqpBox:
    """The condensed form; any Hessian can follow, for the pattern is a full upper triangle.

    The matrices of trained models are well scaled (condition number a few hundred), so the equilibration that
    OSQP would do at every update is left out: a third of the time, the same iterations. OSQP stops at a
    tolerance relative to the gradient; `Refinement` mends the solutions that this leaves too far off.
    """

    exact = False

    def __init__(self, low: Array, high: Array, tolerance: float) -> None:
        """Set up on the identity."""
        size = low.size
        upper = np.triu_indices(size)
        order = np.lexsort(upper)  # column-major order, as CSC stores it
        self._entries = (upper[0] * size + upper[1])[order]
        pattern = sparse.csc_matrix(np.triu(np.ones((size, size))))
        pattern.data[:] = np.eye(size).ravel()[self._entries]
        self._workspace = Workspace(
            pattern,
            sparse.csc_matrix(sparse.eye_array(size)),
            low,
            high,
            eps_abs=tolerance,
            eps_rel=tolerance,
            scaling=0,
            check_termination=10,
        )

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        return self._workspace.iterations

    def solve(self, hessian: Array, gradient: Array) -> Array:
        """See `BoxSolver.solve`."""
        # osqp keeps the last problem when it refuses an update, and does not say so.
        check_entries("osqp", hessian, gradient)
        self._workspace.solver.update(Px=hessian.ravel()[self._entries], q=gradient)
        return self._workspace.solve()

    def start_at(self, x: Array) -> None:
        """See `BoxSolver.start_at`."""
        self._workspace.solver.warm_start(x=x)

    def restart(self) -> None:
        """See `BoxSolver.restart`."""
        self._workspace.restart()


class OsqpSparse:
    """The sparse form: equality rows, then one row for every limited variable."""

    def __init__(
        self, weights: Array, matrix: SparseMatrix, low: Array, high: Array, tolerance: float
    ) -> None:
        """Set up on a pattern.

        Args:
            weights: Diagonal of P (n,).
            matrix: A (m, n) with every entry that can occur.
            low: (n,), minus infinity where there is no limit.
            high: (n,).
            tolerance: Absolute and relative.
        """
        rows = matrix.get_shape()[0]
        limited = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
        limits = sparse.csr_array(sparse.eye_array(low.size, format="csr"))[limited]
        numbered = matrix.copy()
        numbered.data = np.arange(1.0, matrix.nnz + 1)
        stacked = sparse.csc_matrix(sparse.vstack((numbered, -limits)))
        stacked.sort_indices()
        self._positions = np.flatnonzero(stacked.data > 0).astype(np.int32)
        self._order = (stacked.data[self._positions] - 1).astype(np.int64)
        stacked.data = np.ones_like(stacked.data)
        stacked.data[self._positions] = matrix.data[self._order]
        self._equalities = slice(0, rows)
        self._low = np.concatenate((np.zeros(rows), low[limited]))
        self._high = np.concatenate((np.zeros(rows), high[limited]))
        self._workspace = Workspace(
            sparse.csc_matrix(sparse.diags_array(weights)),
            stacked,
            self._low,
            self._high,
            eps_abs=tolerance,
            eps_rel=tolerance,
        )

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        return self._workspace.iterations

    def solve(self, entries: Array, right: Array) -> Array:
        """See `SparseSolver.solve`."""
        check_entries("osqp", entries, right)
        self._low[self._equalities] = self._high[self._equalities] = right
        self._workspace.solver.update(
            Ax=entries[self._order], Ax_idx=self._positions, l=self._low, u=self._high
        )
        return self._workspace.solve()

    def start_at(self, x: Array) -> None:
        """See `SparseSolver.start_at`."""
        self._workspace.solver.warm_start(x=x)

    def restart(self) -> None:
        """See `SparseSolver.restart`."""
        self._workspace.restart()
