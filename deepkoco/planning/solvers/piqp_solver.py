"""PIQP, a proximal interior-point solver; optional, from the extra `solvers`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from deepkoco.planning.errors import SolverError
from deepkoco.planning.solvers.interface import Array, SparseMatrix, check_entries

if TYPE_CHECKING:
    import piqp


def _solution(solver: Any) -> Array:
    """Run PIQP and take its solution."""
    status = solver.solve()
    if status.name != "PIQP_SOLVED":
        raise SolverError(f"piqp: {status.name.removeprefix('PIQP_').lower().replace('_', ' ')}")
    return np.array(solver.result.x)


class PiqpBox:
    """The condensed form. An interior-point method gains nothing from a start, so both requests do nothing."""

    exact = False

    def __init__(self, low: Array, high: Array, tolerance: float) -> None:
        """Set up on the identity."""
        import piqp

        self.iterations = 0
        self._solver: piqp.DenseSolver = piqp.DenseSolver()
        self._solver.settings.eps_abs = self._solver.settings.eps_rel = tolerance
        self._solver.setup(np.asfortranarray(np.eye(low.size)), np.zeros(low.size), x_l=low, x_u=high)

    def solve(self, hessian: Array, gradient: Array) -> Array:
        """See `BoxSolver.solve`."""
        check_entries("piqp", hessian, gradient)
        self._solver.update(P=hessian.T, c=gradient)  # symmetric, and the transpose is in Fortran's order
        x = _solution(self._solver)
        self.iterations = self._solver.result.info.iter
        return x

    def start_at(self, x: Array) -> None:
        """See `BoxSolver.start_at`."""

    def restart(self) -> None:
        """See `BoxSolver.restart`."""


class PiqpSparse:
    """The sparse form."""

    def __init__(
        self, weights: Array, matrix: SparseMatrix, low: Array, high: Array, tolerance: float
    ) -> None:
        """Set up on a pattern; see `OsqpSparse`."""
        import piqp

        self.iterations = 0
        self._matrix = matrix.copy()
        self._solver: piqp.SparseSolver = piqp.SparseSolver()
        self._solver.settings.eps_abs = self._solver.settings.eps_rel = tolerance
        hessian = sparse.csc_matrix(sparse.diags_array(weights))
        self._solver.setup(
            hessian, np.zeros(low.size), self._matrix, np.zeros(matrix.get_shape()[0]), x_l=low, x_u=high
        )

    def solve(self, entries: Array, right: Array) -> Array:
        """See `SparseSolver.solve`."""
        check_entries("piqp", entries, right)
        self._matrix.data[:] = entries
        self._solver.update(A=self._matrix, b=right)
        x = _solution(self._solver)
        self.iterations = self._solver.result.info.iter
        return x

    def start_at(self, x: Array) -> None:
        """See `SparseSolver.start_at`."""

    def restart(self) -> None:
        """See `SparseSolver.restart`."""
