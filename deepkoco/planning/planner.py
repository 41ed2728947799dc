"""The planner that never fails its caller."""

from __future__ import annotations

import logging
import time

import numpy as np

from deepkoco.planning.config import Array
from deepkoco.planning.errors import SolverError
from deepkoco.planning.program import Program, shifted
from deepkoco.planning.statistics import PlannerStatistics

logger = logging.getLogger(__name__)


class Planner:
    """Plans action increments; holds the last plan when a program is not solved.

    One object serves one control loop: it keeps one program, updated at every step, and the last plan. A
    failure takes the next increment of that plan (zero once it is used up), is counted in `statistics` and
    logged. Make one with `make_planner`.

    Attributes:
        statistics: What happened so far.
    """

    def __init__(
        self, program: Program, action_low: Array, action_high: Array, diagnostics: bool = False
    ) -> None:
        """Keep the program.

        Args:
            program: Solved at every step.
            action_low: a_min (M,).
            action_high: a_max (M,).
            diagnostics: Collect all of `statistics`, which takes some 20 microseconds per decision.
        """
        self._program = program
        self._low, self._high = np.asarray(action_low, np.float64), np.asarray(action_high, np.float64)
        self._diagnostics = diagnostics
        self.statistics = PlannerStatistics()
        self._planned: Array | None = None

    @property
    def planned(self) -> Array | None:
        """The plan that is followed: actions a_1 .. a_H (H, M), the first of them decided last.

        A failure moves it on by one step; None before the first plan of an episode.
        """
        return self._planned

    def reset(self) -> None:
        """Forget the last plan at the start of an episode."""
        self._planned = None
        self.statistics.planned_costs = []
        self._program.reset()

    def plan(self, rows: Array, factor: Array, action: Array) -> Array:
        """Decide the next action increment; rows, factor and action as in `Program.solve`.

        Returns:
            Increment da_0 (M,) with a_0 + da_0 inside the limits.
        """
        self.statistics.plans += 1
        try:
            solve = self._observed_solve if self._diagnostics else self._program.solve
            planned = solve(rows, factor, action)
            if not np.isfinite(planned).all():
                raise SolverError("the plan is not finite")
        except SolverError as error:
            increment = self._hold(str(error))
        else:
            increment = planned[0] - action
            self.statistics.refined += self._program.refined
            self._planned = planned.copy()  # some solvers give out memory that they write to again
        return np.minimum(np.maximum(action + increment, self._low), self._high) - action

    def _observed_solve(self, rows: Array, factor: Array, action: Array) -> Array:
        """Solve and take down what happened."""
        statistics = self.statistics
        statistics.planned_costs.append(float("nan"))
        start = time.perf_counter()
        planned = self._program.solve(rows, factor, action)
        statistics.seconds += time.perf_counter() - start
        statistics.solved += 1
        statistics.iterations += self._program.iterations
        near = 1e-6 * (self._high - self._low)
        statistics.active_limits += int(
            ((planned <= self._low + near) | (planned >= self._high - near)).sum()
        )
        statistics.log_conditioning += float(np.log(self._program.conditioning()))
        statistics.planned_costs[-1] = self._program.planned_cost(planned)
        return planned

    def _hold(self, reason: str) -> Array:
        """Count a failure and take the next increment of the last plan."""
        statistics = self.statistics
        statistics.failures += 1
        statistics.reasons[reason] += 1
        if statistics.failures & (statistics.failures - 1) == 0:  # 1st, 2nd, 4th, 8th ...
            logger.warning(
                "plan not solved (%s), failure %d: holding the last plan", reason, statistics.failures
            )
        if self._planned is None:
            return np.zeros_like(self._low)
        before, self._planned = self._planned, shifted(self._planned)
        return self._planned[0] - before[0]
