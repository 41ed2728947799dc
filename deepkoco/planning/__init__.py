"""Model-predictive control on the latent model."""

from deepkoco.planning.config import PlannerConfig, PlanningProblem
from deepkoco.planning.errors import PlannerConfigError, SolverError, UnknownSolverError
from deepkoco.planning.methods import METHODS, make_planner
from deepkoco.planning.planner import Planner
from deepkoco.planning.statistics import PlannerStatistics

__all__ = [
    "METHODS",
    "Planner",
    "PlannerConfig",
    "PlannerConfigError",
    "PlannerStatistics",
    "PlanningProblem",
    "SolverError",
    "UnknownSolverError",
    "make_planner",
]
