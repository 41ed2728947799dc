"""Box-constrained QP solvers that are set up once and updated at every step."""

from __future__ import annotations

from typing import Protocol

import daqp
import numpy as np
import osqp
import qpsolvers
from scipy import sparse

from deepkoco.planning.config import Array, SolverError, check_solver

LARGEST_ENTRY = 1e20  # OSQP takes 1e30 for infinity and refuses silently; beyond 1e20 doubles are of no use


class BoxSolver(Protocol):
    """Minimises x'Px/2 + q'x subject to low <= x <= high, with fixed limits."""

    def solve(self, hessian: Array, gradient: Array) -> Array:
        """Solve for a new P (n, n) and q (n,); returns x (n,) or raises `SolverError`."""
        ...


class DaqpSolver:
    """Dual active-set solver; its workspace is kept between calls."""

    def __init__(self, low: Array, high: Array, tolerance: float) -> None:
        """Keep the limits; the workspace is made with the first problem."""
        self._low, self._high = low, high
        self._no_rows = np.empty((0, low.size))
        self._workspace = daqp.Model()
        self._ready = False

    def solve(self, hessian: Array, gradient: Array) -> Array:
        """See `BoxSolver.solve`."""
        # daqp calls a problem with NaN solved.
        check_entries("daqp", hessian, gradient)
        if self._ready:
            status = self._workspace.update(H=hessian, f=gradient)
            if status < 0:
                raise SolverError(f"daqp: exit flag {status} at update")
        else:
            status, _ = self._workspace.setup(hessian, gradient, self._no_rows, self._high, self._low)
            if status < 0:
                raise SolverError(f"daqp: exit flag {status} at set-up")
            self._ready = True
        x, _, status, _ = self._workspace.solve()
        if status != 1:
            raise SolverError(f"daqp: exit flag {status}")
        return x


class OsqpSolver:
    """Operator-splitting solver, updated in place and warm-started."""

    def __init__(self, low: Array, high: Array, tolerance: float) -> None:
        """Set up on a problem with a full upper triangle, so that any Hessian can follow."""
        size = low.size
        self._upper = np.triu_indices(size)
        self._columns = np.lexsort(self._upper)  # column-major order, as CSC stores it
        pattern = sparse.csc_matrix(np.triu(np.ones((size, size))))
        pattern.data[:] = np.eye(size)[self._upper][self._columns]
        self._solver = osqp.OSQP()
        self._solver.setup(
            pattern,
            np.zeros(size),
            sparse.identity(size, format="csc"),
            low,
            high,
            verbose=False,
            eps_abs=tolerance,
            eps_rel=tolerance,
            max_iter=20000,
        )

    def solve(self, hessian: Array, gradient: Array) -> Array:
        """See `BoxSolver.solve`."""
        # osqp keeps the last problem when it refuses an update, and does not say so.
        check_entries("osqp", hessian, gradient)
        self._solver.update(Px=hessian[self._upper][self._columns], q=gradient)
        return osqp_solution(self._solver)


class QpsolversSolver:
    """Any other solver known to qpsolvers; it offers no update, so every call sets up anew."""

    def __init__(self, name: str, low: Array, high: Array) -> None:
        """Keep the limits."""
        self._name, self._low, self._high = name, low, high

    def solve(self, hessian: Array, gradient: Array) -> Array:
        """See `BoxSolver.solve`."""
        check_entries(self._name, hessian, gradient)
        try:
            x = qpsolvers.solve_qp(hessian, gradient, lb=self._low, ub=self._high, solver=self._name)
        except Exception as error:  # each solver has its own classes, and a controller must not end with them
            raise SolverError(f"{self._name}: {error}") from error
        if x is None:
            raise SolverError(f"{self._name}: no solution found")
        return x


def check_entries(solver: str, *arrays: Array) -> None:
    """Refuse a problem with entries that are not finite or too large for a solver.

    Args:
        solver: Its name, for the message.
        *arrays: Any shapes.

    Raises:
        SolverError: The root of the sum of squares of an array is not below 1e20.
    """
    for array in arrays:
        # One product finds every NaN, infinity and large number, in a third of the time of abs and max.
        if not np.vdot(array, array) < LARGEST_ENTRY**2:
            raise SolverError(f"{solver}: the problem has entries that are not finite or above 1e20")


def osqp_solution(solver: osqp.OSQP) -> Array:
    """Run OSQP and take its solution.

    Args:
        solver: A solver that is set up and updated.

    Returns:
        The solution vector.

    Raises:
        SolverError: OSQP reports anything but "solved".
    """
    result = solver.solve(raise_error=False)
    if result.info.status != "solved":
        raise SolverError(f"osqp: {result.info.status}")
    return np.asarray(result.x)


def make_box_solver(name: str, low: Array, high: Array, tolerance: float) -> BoxSolver:
    """Make a solver by name.

    Args:
        name: "daqp", "osqp" or a name of `qpsolvers.available_solvers`.
        low: Lower limits (n,).
        high: Upper limits (n,).
        tolerance: For OSQP.

    Returns:
        The solver.

    Raises:
        UnknownSolverError: No such solver is installed.
    """
    check_solver(name)
    if name == "daqp":
        return DaqpSolver(low, high, tolerance)
    if name == "osqp":
        return OsqpSolver(low, high, tolerance)
    return QpsolversSolver(name, low, high)
