"""Runs a trained controller and its references from the same start states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.buffer import Episode
from deepkoco.agent.collection import episode_costs
from deepkoco.agent.first_episodes import fit_linear, planner_of_linear
from deepkoco.agent.metrics import Row
from deepkoco.agent.references.advice import Evidence, advise
from deepkoco.agent.references.comparison import EDMDC, RANDOM, ZERO, Comparison
from deepkoco.agent.references.same_starts import MakeController, SameStarts
from deepkoco.koopman.exported import Array
from deepkoco.koopman.lifting.lifted_linear import LiftedModelError
from deepkoco.planning.config import PlannerConfig


@dataclass(frozen=True)
class Trained:
    """A training at its end.

    Attributes:
        name: Of the agent.
        controller: Makes the trained controller, without exploration.
        exploration: Makes what acted in the first episodes, with noise of its own.
        first: The first episodes as they were recorded.
        rows: Metrics, one row per iteration.
        planner: Settings of the planner, also for EDMDc.
        action_weight: R, one for all actions or one each (M,).
        time_step: Seconds per step.
        low, high: Limits of the actions (M,).
        window: T + 1, see `Evidence`.
        plans: Whether the agent plans.
        total_episodes: Episodes of the training.
        seed: Of the draws that EDMDc makes.
        kept: What the controller is, where it is not what was trained.
        to_come: Whether means of the costs to come were learned.
    """

    name: str
    controller: MakeController
    exploration: MakeController
    first: Sequence[Episode]
    rows: Sequence[Row]
    planner: PlannerConfig
    action_weight: float | Array
    time_step: float
    low: Array
    high: Array
    window: int | None
    plans: bool
    total_episodes: int
    seed: int
    kept: str = ""
    to_come: bool = False


def compare(trained: Trained, starts: SameStarts) -> Comparison:
    """Compare a trained controller with zero action, random episodes and EDMDc with the same planner.

    Args:
        trained: The training.
        starts: The start states.

    Returns:
        Costs of all of them, with advice where the controller is not better than each.
    """
    low, high, planner = trained.low, trained.high, trained.planner
    states = trained.first[0].observations.dim() == 2
    makes: dict[str, MakeController] = {
        trained.name: trained.controller,
        ZERO: lambda count: VectorAgent(None, planner, low, high, count),
        RANDOM: trained.exploration,
    }
    left_out = {}
    if states:
        try:
            linear = fit_linear(
                trained.first, trained.time_step, trained.action_weight, planner.horizon, trained.seed
            )
        except LiftedModelError as error:
            left_out[EDMDC] = f"it cannot be fitted ({error})"
        else:
            own = planner_of_linear(planner)
            makes[EDMDC] = lambda count: VectorAgent(linear, own, low, high, count)
    else:
        left_out[EDMDC] = "it does not apply to frames"
    episodes = {name: starts.run(make, record=states) for name, make in makes.items()}
    costs = {name: episode_costs(own) for name, own in episodes.items()}
    comparison = Comparison(trained.name, costs, left_out, kept=trained.kept)
    return replace(comparison, advice=_advice(trained, comparison, episodes))


def _advice(trained: Trained, comparison: Comparison, episodes: dict[str, list[Episode]]) -> tuple[str, ...]:
    if not comparison.needs_advice:
        return ()
    ranked = sorted(comparison.references, key=lambda reference: reference.cost.mean)
    return advise(
        Evidence(
            trained.first,
            episodes[trained.name],
            {reference.name: episodes[reference.name] for reference in ranked},
            trained.rows,
            trained.low,
            trained.high,
            trained.window,
            trained.planner.horizon * trained.time_step if trained.plans else None,
            trained.total_episodes,
            trained.to_come,
        )
    )
