"""What a program asks of a solver."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from deepkoco.planning.errors import SolverError

Array = NDArray[np.float64]
SparseMatrix = sparse.csc_matrix
LARGEST_ENTRY = 1e20  # OSQP takes 1e30 for infinity and refuses silently; beyond 1e20 doubles are of no use


class BoxSolver(Protocol):
    """Minimises x'Px/2 + q'x subject to low <= x <= high, with fixed limits.

    A solver goes on from its own last solution unless it is told otherwise between two solves.

    Attributes:
        exact: Whether it solves a well-conditioned problem to round-off, whatever the tolerance.
    """

    exact: bool

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        ...

    def solve(self, hessian: Array, gradient: Array) -> Array:
        """Solve for a new P (n, n) and q (n,); returns x (n,) or raises `SolverError`."""
        ...

    def start_at(self, x: Array) -> None:
        """Begin the next solve at x (n,)."""
        ...

    def restart(self) -> None:
        """Begin the next solve as a new solver would."""
        ...


class SparseSolver(Protocol):
    """Minimises x'Px/2 subject to A x = b and low <= x <= high; P, low and high are fixed."""

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        ...

    def solve(self, entries: Array, right: Array) -> Array:
        """Solve for new entries of A (nnz,), in CSC order, and b (m,); returns x (n,) or raises `SolverError`."""
        ...

    def start_at(self, x: Array) -> None:
        """Begin the next solve at x (n,)."""
        ...

    def restart(self) -> None:
        """Begin the next solve as a new solver would."""
        ...


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
