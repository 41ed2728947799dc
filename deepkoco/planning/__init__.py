"""Linear model-predictive control on the latent model."""

from deepkoco.planning.config import (
    PlannerConfig,
    PlannerConfigError,
    PlanningProblem,
    SolverError,
    UnknownSolverError,
)
from deepkoco.planning.lmpc import LinearMPC, PlannerStatistics

__all__ = [
    "LinearMPC",
    "PlannerConfig",
    "PlannerConfigError",
    "PlannerStatistics",
    "PlanningProblem",
    "SolverError",
    "UnknownSolverError",
]
