"""Linear model-predictive control on the latent model."""

from deepkoco.planning.config import PlannerConfig, PlanningProblem, SolverError
from deepkoco.planning.lmpc import LinearMPC, PlannerConfigError, PlannerStatistics

__all__ = [
    "LinearMPC",
    "PlannerConfig",
    "PlannerConfigError",
    "PlannerStatistics",
    "PlanningProblem",
    "SolverError",
]
