"""QP solvers that are set up once and updated at every step; one file per solver."""

from deepkoco.planning.solvers.interface import BoxSolver, SparseSolver
from deepkoco.planning.solvers.registry import (
    AUTOMATIC,
    BOX_SOLVERS,
    SPARSE_SOLVERS,
    check_solver,
    make_box_solver,
    make_sparse_solver,
    solver_names,
)

__all__ = [
    "AUTOMATIC",
    "BOX_SOLVERS",
    "SPARSE_SOLVERS",
    "BoxSolver",
    "SparseSolver",
    "check_solver",
    "make_box_solver",
    "make_sparse_solver",
    "solver_names",
]
