"""Any other solver known to qpsolvers; it offers no update, so every call sets up anew."""

from __future__ import annotations

from typing import Any

import qpsolvers
from scipy import sparse

from deepkoco.planning.errors import SolverError
from deepkoco.planning.solvers.interface import Array, SparseMatrix, check_entries


def _solve(name: str, start: Array | None, *problem: Any, **limits: Any) -> tuple[Array, int]:
    """Solve once; solution and number of iterations (0 where the solver does not tell)."""
    program = qpsolvers.Problem(*problem, **limits)
    try:
        solution = qpsolvers.solve_problem(program, solver=name, initvals=start)
    except Exception as error:  # each solver has its own classes, and a controller must not end with them
        raise SolverError(f"{name}: {error}") from error
    if solution.x is None or not solution.found:
        raise SolverError(f"{name}: no solution found")
    return solution.x, int((solution.extras or {}).get("iter", 0))


class QpsolversBox:
    """The condensed form."""

    def __init__(self, name: str, low: Array, high: Array) -> None:
        """Keep the limits."""
        self.iterations = 0
        self._sparse = name not in qpsolvers.dense_solvers
        self._name, self._low, self._high = name, low, high
        self._start: Array | None = None

    def solve(self, hessian: Array, gradient: Array) -> Array:
        """See `BoxSolver.solve`."""
        check_entries(self._name, hessian, gradient)
        matrix = sparse.csc_matrix(hessian) if self._sparse else hessian
        x, self.iterations = _solve(self._name, self._start, matrix, gradient, lb=self._low, ub=self._high)
        self._start = x
        return x

    def start_at(self, x: Array) -> None:
        """See `BoxSolver.start_at`."""
        self._start = x

    def restart(self) -> None:
        """See `BoxSolver.restart`."""
        self._start = None


class QpsolversSparse:
    """The sparse form."""

    def __init__(self, name: str, weights: Array, matrix: SparseMatrix, low: Array, high: Array) -> None:
        """Keep the pattern; see `OsqpSparse`."""
        self.iterations = 0
        self._name, self._low, self._high = name, low, high
        self._hessian = sparse.csc_matrix(sparse.diags_array(weights))
        self._gradient = 0.0 * weights
        self._matrix = matrix.copy()
        self._start: Array | None = None

    def solve(self, entries: Array, right: Array) -> Array:
        """See `SparseSolver.solve`."""
        check_entries(self._name, entries, right)
        self._matrix.data[:] = entries
        x, self.iterations = _solve(
            self._name,
            self._start,
            self._hessian,
            self._gradient,
            A=self._matrix,
            b=right,
            lb=self._low,
            ub=self._high,
        )
        self._start = x
        return x

    def start_at(self, x: Array) -> None:
        """See `SparseSolver.start_at`."""
        self._start = x

    def restart(self) -> None:
        """See `SparseSolver.restart`."""
        self._start = None
