"""The linear model-predictive controller that never fails its caller."""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from deepkoco.koopman.latent_model import LatentModel
from deepkoco.planning.condensed import CondensedProgram
from deepkoco.planning.config import Array, PlannerConfig, PlanningProblem, SolverError
from deepkoco.planning.sparse import SparseProgram

logger = logging.getLogger(__name__)


@dataclass
class PlannerStatistics:
    """What happened so far.

    Attributes:
        plans: Decisions asked for.
        failures: Decisions that held the last plan because the program was not solved.
        reasons: Count of each reason.
    """

    plans: int = 0
    failures: int = 0
    reasons: Counter[str] = field(default_factory=Counter)


class LinearMPC:
    """Plans action increments; holds the last plan when a program is not solved.

    One object serves one control loop: it keeps one solver, updated at every step, and the last plan. A
    failure takes the next increment of that plan (zero once it is used up), is counted in `statistics` and
    logged.
    """

    def __init__(
        self, model: LatentModel, config: PlannerConfig, action_low: Array, action_high: Array
    ) -> None:
        """Set up the solver.

        Args:
            model: Gives dynamics, R and r.
            config: Settings.
            action_low: a_min (M,).
            action_high: a_max (M,).

        Raises:
            PlannerConfigError: A setting is out of range.
            UnknownSolverError: The solver is not installed.
        """
        config.check()
        self._low, self._high = np.asarray(action_low, np.float64), np.asarray(action_high, np.float64)
        problem = PlanningProblem(
            model.dynamics,
            self._low,
            self._high,
            model.action_weight,
            config.increment_weight,
            config.horizon,
            model.cost_rank,
        )
        if config.form == "condensed":
            self._program = CondensedProgram(problem, config.solver, config.tolerance)
        else:
            self._program = SparseProgram(problem, config.tolerance)
        self.statistics = PlannerStatistics()
        self._held = np.zeros((0, self._low.size))

    def reset(self) -> None:
        """Forget the last plan at the start of an episode."""
        self._held = self._held[:0]

    def plan(self, rows: Array, factor: Array, action: Array) -> Array:
        """Decide the next action increment.

        Args:
            rows: Latent and input columns (1 + M, n) as given by `LatentModel.linearise`.
            factor: Cost factor C (r, n).
            action: Present action a_0 (M,).

        Returns:
            Increment da_0 (M,) with a_0 + da_0 inside the limits.
        """
        self.statistics.plans += 1
        try:
            planned = self._program.solve(rows, factor, action)
            if not np.isfinite(planned).all():
                raise SolverError("the plan is not finite")
        except SolverError as error:
            increment = self._hold(str(error))
        else:
            increment = planned[0] - action
            self._held = np.diff(planned, axis=0)
        return np.minimum(np.maximum(action + increment, self._low), self._high) - action

    def _hold(self, reason: str) -> Array:
        """Count a failure and take the next increment of the last plan."""
        statistics = self.statistics
        statistics.failures += 1
        statistics.reasons[reason] += 1
        if statistics.failures & (statistics.failures - 1) == 0:  # 1st, 2nd, 4th, 8th ...
            logger.warning(
                "plan not solved (%s), failure %d: holding the last plan", reason, statistics.failures
            )
        if len(self._held) == 0:
            return np.zeros_like(self._low)
        increment, self._held = self._held[0], self._held[1:]
        return increment
