"""Settings and limits of the linear model-predictive controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import qpsolvers
from numpy.typing import NDArray

from deepkoco.koopman.latent_model import LatentDynamics

Array = NDArray[np.float64]
FORMS = ("condensed", "sparse")
UPDATED_SOLVERS = ("daqp", "osqp")  # set up once, updated at every step


class PlannerConfigError(ValueError):
    """A setting of the planner is out of range."""


class UnknownSolverError(ValueError):
    """The named QP solver is not installed."""


class SolverError(RuntimeError):
    """A quadratic program was not solved."""


@dataclass
class PlannerConfig:
    """Settings of the LMPC."""

    horizon: int = 13
    """H, planned steps; a little less than the training horizon T, see docs/training.md."""
    increment_weight: float = 0.01
    """R~, weight of a squared action increment."""
    form: str = "condensed"
    """How the problem is written: "condensed" (actions only) or "sparse" (latents too)."""
    solver: str = "daqp"
    """Backend of the condensed form: "daqp", "osqp" or any other installed solver of qpsolvers."""
    tolerance: float = 1e-6
    """Absolute and relative tolerance of the OSQP backends."""

    def check(self, trained_horizon: int | None = None) -> None:
        """Check the settings.

        Args:
            trained_horizon: T of the training; plans are no longer than that, for modes may grow. None
                leaves this out.

        Raises:
            PlannerConfigError: Names the first setting that is out of range and its remedy.
            UnknownSolverError: The solver is not installed.
        """
        if self.horizon < 1:
            raise PlannerConfigError(f"planner.horizon = {self.horizon}; give at least 1 step")
        if trained_horizon is not None and self.horizon > trained_horizon:
            raise PlannerConfigError(
                f"planner.horizon = {self.horizon} exceeds the training horizon {trained_horizon}; "
                f"give at most {trained_horizon} steps or train with a larger horizon"
            )
        if not 0 <= self.increment_weight < np.inf:
            raise PlannerConfigError(f"planner.increment_weight = {self.increment_weight}; give 0 or more")
        if not 0 < self.tolerance < np.inf:
            raise PlannerConfigError(f"planner.tolerance = {self.tolerance}; give a value above 0")
        if self.form not in FORMS:
            raise PlannerConfigError(f'planner.form = "{self.form}"; choose one of {", ".join(FORMS)}')
        check_solver(self.solver)


def check_solver(name: str) -> None:
    """Check that a solver is installed.

    Args:
        name: "daqp", "osqp" or a name of `qpsolvers.available_solvers`.

    Raises:
        UnknownSolverError: It is not.
    """
    known = sorted({*UPDATED_SOLVERS, *qpsolvers.available_solvers})
    if name not in known:
        raise UnknownSolverError(f'solver "{name}" is not installed; choose one of {", ".join(known)}')


@dataclass(frozen=True)
class PlanningProblem:
    """What stays fixed in a control loop: dynamics, weights and limits.

    Attributes:
        dynamics: A of the free motion s' = A s, for one step.
        action_low: a_min (M,).
        action_high: a_max (M,).
        action_weight: R.
        increment_weight: R~.
        horizon: H.
        cost_rank: r, rows of the cost factor.
    """

    dynamics: LatentDynamics
    action_low: Array
    action_high: Array
    action_weight: float
    increment_weight: float
    horizon: int
    cost_rank: int = 1
