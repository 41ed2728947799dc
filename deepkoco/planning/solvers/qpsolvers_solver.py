"""Any other solver known to qpsolvers; it offers no update, so every call sets up anew."""

from __future__ import annotations

from typing import Any

import qpsolvers
from scipy import sparse

from deepkoco.planning.errors import SolverError
from deepkoco.planning.solvers.interface import Array, SparseMatrix, check_entries


class FreshSolver:
    """Solves every problem anew, from the last solution where the solver takes a start.

    Attributes:
        iterations: Of the last solve; 0 where the solver does not tell.
    """

    def __init__(self, name: str, low: Array, high: Array) -> None:
        """Keep the limits (n,)."""
        self.iterations = 0
        self._name, self._low, self._high = name, low, high
        self._start: Array | None = None

    def start_at(self, x: Array) -> None:
        """See `BoxSolver.start_at`."""
        self._start = x

    def restart(self) -> None:
        """See `BoxSolver.restart`."""
        self._start = None

    def _solve(self, *problem: Any, **equalities: Any) -> Array:
        program = qpsolvers.Problem(*problem, **equalities, lb=self._low, ub=self._high)
        try:
            solution = qpsolvers.solve_problem(program, solver=self._name, initvals=self._start)
        except Exception as error:  # each solver has its own classes, and a controller must not end with them
            raise SolverError(f"{self._name}: {error}") from error
        if solution.x is None or not solution.found:
            raise SolverError(f"{self._name}: no solution found")
        self.iterations = int((solution.extras or {}).get("iter", 0))
        self._start = solution.x
        return solution.x


class QpsolversBox(FreshSolver):
    """The condensed form."""

    exact = False

    def solve(self, hessian: Array, gradient: Array) -> Array:
        """See `BoxSolver.solve`."""
        check_entries(self._name, hessian, gradient)
        takes_dense = self._name in qpsolvers.dense_solvers
        return self._solve(hessian if takes_dense else sparse.csc_matrix(hessian), gradient)


class QpsolversSparse(FreshSolver):
    """The sparse form."""

    def __init__(self, name: str, weights: Array, matrix: SparseMatrix, low: Array, high: Array) -> None:
        """Keep the pattern; see `OsqpSparse`."""
        super().__init__(name, low, high)
        self._hessian = sparse.csc_matrix(sparse.diags_array(weights))
        self._gradient = 0.0 * weights
        self._matrix = matrix.copy()

    def solve(self, entries: Array, right: Array) -> Array:
        """See `SparseSolver.solve`."""
        check_entries(self._name, entries, right)
        self._matrix.data[:] = entries
        return self._solve(self._hessian, self._gradient, A=self._matrix, b=right)
