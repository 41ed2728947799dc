"""What the planners of an evaluation did, as metrics of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.metrics import Row
from deepkoco.koopman.exported import Array
from deepkoco.planning.statistics import PlannerStatistics, planned_and_realised


def planner_metrics(
    agent: VectorAgent | None, costs: Sequence[Array] | None, horizon: int
) -> tuple[Row, Row]:
    """Summarise the planners.

    Args:
        agent: An agent with diagnostics after the episodes; None where there was no evaluation.
        costs: What the steps of each environment's episode cost (L,), as its model predicts it; None where that is
            not known.
        horizon: H.

    Returns:
        Metrics of `metrics.csv`, and those of the events alone: the wall clock, and the share of plans that were
        refined, which older runs have no column for.
    """
    statistics = PlannerStatistics() if agent is None else agent.statistics
    means = statistics.means()
    refined = statistics.refined / statistics.plans if statistics.plans else float("nan")
    events = {"planner/microseconds": means.pop("microseconds"), "planner/refined": refined}
    pairs = np.full((2, 0), np.nan)
    if agent is not None and costs is not None:
        paired = zip(agent.planned_costs, costs, strict=True)
        pairs = np.concatenate([planned_and_realised(p, c, horizon) for p, c in paired], axis=1)
    known = pairs.shape[1] > 0
    spread = known and (pairs.std(1) > 0).all()
    return {
        **{f"planner/{name}": value for name, value in means.items()},
        "planner/planned_cost": float(pairs[0].mean()) if known else float("nan"),
        "planner/realised_cost": float(pairs[1].mean()) if known else float("nan"),
        "planner/cost_correlation": float(np.corrcoef(pairs)[0, 1]) if spread else float("nan"),
    }, events
