"""The solvers by name. A further updated solver is one file and one line here."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import qpsolvers

from deepkoco.extras import install_command
from deepkoco.planning.errors import UnknownSolverError
from deepkoco.planning.solvers.daqp_solver import DaqpBox
from deepkoco.planning.solvers.interface import Array, BoxSolver, SparseMatrix, SparseSolver
from deepkoco.planning.solvers.osqp_solver import OsqpBox, OsqpSparse
from deepkoco.planning.solvers.piqp_solver import PiqpBox, PiqpSparse
from deepkoco.planning.solvers.qpsolvers_solver import QpsolversBox, QpsolversSparse

AUTOMATIC = {"condensed": "daqp", "sparse": "osqp"}
"""What the solver "auto" stands for: the fastest of each form."""
OPTIONAL = ("piqp", "clarabel")
"""Solvers of the extra `solvers`."""

BOX_SOLVERS: dict[str, Callable[[Array, Array, float], BoxSolver]] = {
    "daqp": DaqpBox,
    "osqp": OsqpBox,
    "piqp": PiqpBox,
}
SPARSE_SOLVERS: dict[str, Callable[[Array, SparseMatrix, Array, Array, float], SparseSolver]] = {
    "osqp": OsqpSparse,
    "piqp": PiqpSparse,
}


def solver_names(form: str) -> list[str]:
    """Installed solvers of one form.

    Args:
        form: "condensed" or "sparse".

    Returns:
        Sorted names, without "auto".
    """
    updated, others = (
        (SPARSE_SOLVERS, qpsolvers.sparse_solvers)
        if form == "sparse"
        else (BOX_SOLVERS, qpsolvers.available_solvers)
    )
    return sorted({name for name in updated if find_spec(name) is not None} | set(others))


def check_solver(name: str, form: str) -> str:
    """Check that a solver is installed and solves a form.

    Args:
        name: "auto", or a solver of `solver_names`.
        form: "condensed" or "sparse".

    Returns:
        The solver's name, never "auto".

    Raises:
        UnknownSolverError: It is not.
    """
    if name == "auto":
        return AUTOMATIC[form]
    known = solver_names(form)
    if name in known:
        return name
    if name in OPTIONAL and find_spec(name) is None:
        raise UnknownSolverError(
            f'solver "{name}" is not installed; {install_command("solvers")}, '
            f"or choose one of auto, {', '.join(known)}"
        )
    if name in solver_names("condensed"):
        raise UnknownSolverError(
            f'solver "{name}" takes no sparse problem; choose one of auto, {", ".join(known)}'
        )
    raise UnknownSolverError(f'solver "{name}" is not installed; choose one of auto, {", ".join(known)}')


def make_box_solver(name: str, low: Array, high: Array, tolerance: float) -> BoxSolver:
    """Make a solver of the condensed form.

    Args:
        name: "auto", "daqp", "osqp", "piqp" or a name of `qpsolvers.available_solvers`.
        low: Lower limits (n,).
        high: Upper limits (n,).
        tolerance: Of the updated solvers that iterate.

    Returns:
        The solver.

    Raises:
        UnknownSolverError: No such solver is installed.
    """
    name = check_solver(name, "condensed")
    if name in BOX_SOLVERS:
        return BOX_SOLVERS[name](low, high, tolerance)
    return QpsolversBox(name, low, high)


def make_sparse_solver(
    name: str, weights: Array, matrix: SparseMatrix, low: Array, high: Array, tolerance: float
) -> SparseSolver:
    """Make a solver of the sparse form.

    Args:
        name: "auto", "osqp", "piqp" or a name of `qpsolvers.sparse_solvers`.
        weights: Diagonal of P (n,).
        matrix: A (m, n) with every entry that can occur.
        low: Lower limits (n,), minus infinity where there is none.
        high: Upper limits (n,).
        tolerance: Of the updated solvers.

    Returns:
        The solver.

    Raises:
        UnknownSolverError: No such solver is installed, or it takes no sparse problem.
    """
    name = check_solver(name, "sparse")
    if name in SPARSE_SOLVERS:
        return SPARSE_SOLVERS[name](weights, matrix, low, high, tolerance)
    return QpsolversSparse(name, weights, matrix, low, high)
