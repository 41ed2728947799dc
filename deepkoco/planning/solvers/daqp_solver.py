"""DAQP, a dual active-set solver for small dense problems."""

from __future__ import annotations

import daqp
import numpy as np

from deepkoco.planning.errors import SolverError
from deepkoco.planning.solvers.interface import Array, check_entries

ACTIVE_HIGH, ACTIVE_LOW = 1, 3  # bit 0: in the working set, bit 1: at the lower limit


class DaqpBox:
    """Keeps one workspace; the working set of the last solution is where the next solve begins.

    Source: Arnstroem, Bemporad and Axehill, A dual active-set solver for embedded quadratic programming
    using recursive LDL' updates, IEEE TAC 2022.
    """

    exact = True

    def __init__(self, low: Array, high: Array, tolerance: float) -> None:
        """Keep the limits; the workspace is made with the first problem. It solves to round-off."""
        self.iterations = 0
        self._low, self._high = low, high
        self._no_rows = np.empty((0, low.size))
        self._workspace = daqp.Model()
        self._ready = False
        self._working_set: np.ndarray | None = None

    def solve(self, hessian: Array, gradient: Array) -> Array:
        """See `BoxSolver.solve`."""
        # daqp calls a problem with NaN solved.
        check_entries("daqp", hessian, gradient)
        if self._ready:
            if self._working_set is None:
                status = self._workspace.update(H=hessian, f=gradient)
            else:
                status = self._workspace.update(H=hessian, f=gradient, sense=self._working_set)
                self._working_set = None
            if status < 0:
                raise SolverError(f"daqp: exit flag {status} at update")
        else:
            status, _ = self._workspace.setup(hessian, gradient, self._no_rows, self._high, self._low)
            if status < 0:
                raise SolverError(f"daqp: exit flag {status} at set-up")
            self._ready = True
        x, _, status, info = self._workspace.solve()
        self.iterations = info["iterations"]
        if status != 1:
            raise SolverError(f"daqp: exit flag {status}")
        return x

    def start_at(self, x: Array) -> None:
        """See `BoxSolver.start_at`; an active-set solver begins with the limits that x touches."""
        self._working_set = ACTIVE_HIGH * (x >= self._high).astype(np.int32)
        self._working_set[x <= self._low] = ACTIVE_LOW

    def restart(self) -> None:
        """See `BoxSolver.restart`."""
        self._working_set = np.zeros(self._low.size, np.int32)
