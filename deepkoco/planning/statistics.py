"""What a planner did: failures always, the rest when it is asked for."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from deepkoco.planning.config import Array


@dataclass
class PlannerStatistics:
    """Sums over decisions; the second half is collected by planners with `diagnostics`.

    Attributes:
        plans: Decisions asked for.
        failures: Decisions that held the last plan because the program was not solved.
        reasons: Count of each reason.
        refined: Decisions whose solution was too far from the optimum and was replaced, see `Refinement`.
        solved: Decisions with diagnostics.
        seconds: Time of the solves, matrices included, network excluded [s].
        iterations: Of the solver.
        active_limits: Planned actions at a limit, of H M per plan.
        log_conditioning: Sum of the natural logarithm of the Hessians' estimated condition numbers.
        planned_costs: Predicted cost over H steps of every decision of the present episode; NaN for failures.
    """

    plans: int = 0
    failures: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    refined: int = 0
    solved: int = 0
    seconds: float = 0.0
    iterations: int = 0
    active_limits: int = 0
    log_conditioning: float = 0.0
    planned_costs: list[float] = field(default_factory=list)

    def add(self, other: PlannerStatistics) -> None:
        """Add the sums of another controller; its episode's planned costs stay its own.

        Args:
            other: Of the other controller.
        """
        for name in ("plans", "failures", "refined", "solved", "seconds", "iterations", "active_limits"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.log_conditioning += other.log_conditioning
        self.reasons.update(other.reasons)

    def means(self) -> dict[str, float]:
        """Means over the solved decisions.

        Returns:
            `microseconds`, `iterations`, `active_limits` per plan and the geometric mean `conditioning`; NaN
            without diagnostics.
        """
        if self.solved == 0:
            return dict.fromkeys(
                ("microseconds", "iterations", "active_limits", "conditioning"), float("nan")
            )
        return {
            "microseconds": 1e6 * self.seconds / self.solved,
            "iterations": self.iterations / self.solved,
            "active_limits": self.active_limits / self.solved,
            "conditioning": float(np.exp(self.log_conditioning / self.solved)),
        }


def planned_and_realised(planned: Array, costs: Array, horizon: int) -> Array:
    """Pair the cost of each plan with what the following steps did cost.

    A plan of step k predicts the costs of steps k + 1 .. k + H. Later plans replace all of it but the first
    action, so the realised cost may well be the lower one.

    Args:
        planned: Predicted cost of the plan of each step (n,), NaN where there was none.
        costs: Cost of each step (n,).
        horizon: H.

    Returns:
        Planned and realised cost (2, m) of the m decisions with a plan and H steps behind them.
    """
    sums = np.concatenate(([0.0], np.cumsum(costs)))
    count = max(0, len(costs) - horizon)
    pairs = np.stack((planned[:count], sums[horizon + 1 :][:count] - sums[1 : count + 1]))
    return pairs[:, np.isfinite(pairs).all(0)]
