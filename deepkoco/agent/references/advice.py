"""What to try where a trained controller is no better than a reference; every proposal follows from a measurement."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deepkoco.agent.buffer import Episode
from deepkoco.agent.metrics import Row
from deepkoco.agent.references.comparison import RANDOM
from deepkoco.agent.task_scale import lowest_cost
from deepkoco.koopman.exported import Array
from deepkoco.pages.units import rounded

MOST_PROPOSALS = 3
CHEAP_SHARE = 0.2
RARE_MARGIN = 0.05
"""Share of a reward by which it is above the usual one, at least, to be rare."""


@dataclass(frozen=True)
class Evidence:
    """What is known of a training at its end.

    Attributes:
        first: Its first, random episodes.
        own: Episodes of the trained controller.
        others: Episodes of the references, by name; the one with the lowest cost first.
        rows: Metrics, one row per iteration.
        low, high: Limits of the actions (M,).
        window: T + 1, steps of a training window; None for an agent that learns from single transitions.
        planned_time: H steps of the planner [s]; None for an agent without one.
        total_episodes: Episodes of the training.
        to_come: Whether means of the costs to come were learned, which rare rewards are part of.
    """

    first: Sequence[Episode]
    own: Sequence[Episode]
    others: Mapping[str, Sequence[Episode]]
    rows: Sequence[Row]
    low: Array
    high: Array
    window: int | None
    planned_time: float | None
    total_episodes: int
    to_come: bool = False

    def last(self, name: str) -> float:
        """A metric of the last row; NaN where there is none."""
        return self.rows[-1].get(name, float("nan")) if self.rows else float("nan")


def advise(evidence: Evidence, most: int = MOST_PROPOSALS) -> tuple[str, ...]:
    """Proposals for another training.

    Args:
        evidence: What was measured.
        most: How many proposals.

    Returns:
        One sentence each, cause and remedy; what matters most first.
    """
    found = [text for rule in RULES if (text := rule(evidence)) is not None]
    if not found:
        found = [
            f"nothing measured says why; more episodes (agent.total_episodes={2 * evidence.total_episodes})"
        ]
    return tuple(found[:most])


def _rare_rewards(evidence: Evidence) -> str | None:
    costs = np.concatenate([episode.costs.numpy() for episode in (*evidence.first, *evidence.own)])
    counted = lowest_cost(evidence.first)
    lowest = float(costs.min())
    if (
        evidence.planned_time is None
        or evidence.to_come
        or lowest >= counted - RARE_MARGIN * max(abs(lowest), abs(counted))
    ):
        return None
    return (
        f"rare rewards up to {rounded(-lowest)} count as {rounded(abs(counted))}, for a squared cost"
        " represents none above what nearly every step pays; a reward that grows on the way to the goal"
    )


def _short_episodes(evidence: Evidence) -> str | None:
    lengths = np.array([episode.costs.numel() for episode in evidence.first])
    if evidence.window is None or (share := float((lengths < evidence.window).mean())) < 0.2:
        return None
    return (
        f"{100 * share:.0f} % of the first episodes end before one training window of {evidence.window} steps; calmer "
        "exploration (agent.noise_floor=0.03), or windows and plans as short as they are (agent.horizon, "
        "agent.planner.horizon)"
    )


def _leaves_the_range(evidence: Evidence) -> str | None:
    best = next((name for name in evidence.others if name != RANDOM), None)
    if best is None or (first := _observations(evidence.first)) is None:
        return None
    # Where a reference does no better than noise, where it goes is not where the task is.
    if RANDOM in evidence.others and _cost(evidence.others[best]) >= _cost(evidence.others[RANDOM]):
        return None
    needed = _observations(evidence.others[best])
    assert needed is not None
    reached, wanted = (np.quantile(np.abs(o - np.median(needed, 0)), 0.95, axis=0) for o in (first, needed))
    moved = wanted > 1e-6 * np.maximum(reached, 1e-12)
    ratios = np.where(moved, reached / np.where(moved, wanted, 1.0), 0.0)
    entry = int(ratios.argmax())
    if ratios[entry] < 5.0:
        return None
    return (
        f"the first episodes go {rounded(float(ratios[entry]))} times as far as those of {best} (entry {entry} of the "
        f"observation: {rounded(float(reached[entry]))} against {rounded(float(wanted[entry]))}); "
        f"less exploration{' noise (agent.noise_variance)' if evidence.planned_time is not None else ''} or shorter "
        "episodes"
    )


def _spread(evidence: Evidence) -> str | None:
    if (seen := _observations(evidence.first)) is None:
        return None
    spread = seen.std(0)
    moving = np.flatnonzero(spread > 1e-9)
    if moving.size < 2:
        return None
    small, large = moving[spread[moving].argmin()], moving[spread[moving].argmax()]
    if spread[large] < 20.0 * spread[small]:
        return None
    return (
        f"entry {large} of the observation varies {rounded(float(spread[large] / spread[small]))} times as much as "
        f"entry {small}; scale the observations"
    )


def _noise(evidence: Evidence) -> str | None:
    if evidence.planned_time is None:
        return None
    actions = np.concatenate([episode.actions.numpy() for episode in evidence.first]).astype(np.float64)
    low, high = np.quantile(actions, [0.05, 0.95], axis=0)
    share = float(((high - low) / np.maximum(evidence.high - evidence.low, 1e-12)).min())
    if share > 0.2:
        return None
    return (
        f"the first episodes use {100 * share:.0f} % of the range of an action; more exploration noise "
        "(agent.noise_variance)"
    )


def _flat_cost(evidence: Evidence) -> str | None:
    costs = np.concatenate([episode.costs.numpy() for episode in evidence.first]).astype(np.float64)
    if costs.std() > 0.02 * abs(costs.mean()):
        return None
    return (
        f"the cost of a step hardly varies in the first episodes ({rounded(float(costs.mean()))} ± "
        f"{rounded(float(costs.std()))}), so nothing says where the goal is; a cost that falls on the way to it"
    )


def _rare_cheap_steps(evidence: Evidence) -> str | None:
    costs = np.concatenate([episode.costs.numpy() for episode in evidence.first]).astype(np.float64)
    costs = costs[np.isfinite(costs)]
    lowest, usual, highest = np.quantile(costs, [0.0, CHEAP_SHARE, 1.0])
    if not usual > highest - 0.1 * (highest - lowest):
        return None
    share = float((costs < highest - 0.1 * (highest - lowest)).mean())
    return (
        f"only {100.0 * share:.2g} % of the steps of the first episodes cost less than {rounded(float(usual))}, so "
        "hardly anything says where the goal is; a cost that falls on the way to it, or more episodes "
        f"(agent.total_episodes={2 * evidence.total_episodes})"
    )


def _failures(evidence: Evidence) -> str | None:
    decisions = sum(episode.costs.numel() for episode in evidence.own) / max(1, len(evidence.own))
    decisions *= evidence.last("evaluation/episodes")
    share = evidence.last("evaluation/planner_failures") / decisions if decisions else 0.0
    if not share > 0.01:
        return None
    return f"{100 * share:.0f} % of the plans could not be made; agent.planner.horizon shorter"


def _growing_mode(evidence: Evidence) -> str | None:
    if evidence.planned_time is None:
        return None
    growth = float(np.exp(min(evidence.last("model/largest_growth_rate") * evidence.planned_time, 700.0)))
    if not growth > 50.0:
        return None
    return f"a mode of the latent grows {rounded(growth)} times over one plan; agent.planner.horizon shorter"


def _unpredicted(evidence: Evidence) -> str | None:
    scale, linear = evidence.last("loss/latent_scale"), evidence.last("loss/linear")
    costs = np.concatenate([episode.costs.numpy() for episode in evidence.first]).astype(np.float64)
    error = evidence.last("loss/cost_prediction")
    if error > 0.5 * costs.var():
        off, spread = rounded(float(np.sqrt(error))), rounded(float(costs.std()))
        said = f"the predicted cost is off by {off} where costs vary by {spread}"
    elif linear > scale**2:
        said = f"the latent is not predicted (loss {rounded(linear)}, its square {rounded(scale**2)})"
    else:
        return None
    return f"{said}; scale cost and observations to about 1, or more updates (agent.iteration_updates=1000)"


def _best_was_earlier(evidence: Evidence) -> str | None:
    # The last row has other start states.
    costs = np.array([row.get("evaluation/cost", np.nan) for row in evidence.rows[:-1]])
    kept = bool(evidence.rows) and "kept/cost" in evidence.rows[-1]
    if kept or evidence.planned_time is None or costs.size < 3 or not np.isfinite(costs).all():
        return None
    best = int(costs.argmin())
    if costs[-1] - costs[best] < 0.3 * abs(costs[best]):
        return None
    return (
        f"weights after {evidence.rows[best]['episodes']:.0f} episodes cost {rounded(float(costs[best]))}, those near "
        f"the end {rounded(float(costs[-1]))}; agent.keep=best agent.evaluation_episodes=30"
    )


def _still_falling(evidence: Evidence) -> str | None:
    costs = np.array([row.get("evaluation/cost", np.nan) for row in evidence.rows[:-1]])
    third = len(costs) // 3
    if third < 1 or not np.isfinite(costs).all():
        return None
    before, end = costs[-2 * third : -third].mean(), costs[-third:].mean()
    if before - end < 0.1 * abs(before):
        return None
    return (
        f"the cost still fell at the end, from {rounded(before)} to {rounded(end)}; more episodes "
        f"(agent.total_episodes={2 * evidence.total_episodes})"
    )


def _saturated(evidence: Evidence) -> str | None:
    actions = np.concatenate([episode.actions.numpy() for episode in evidence.own]).astype(np.float64)
    near = 0.01 * (evidence.high - evidence.low)
    share = float(((actions <= evidence.low + near) | (actions >= evidence.high - near)).mean())
    if share < 0.5 or evidence.planned_time is None:  # other agents have no planner to set
        return None
    return (
        f"{100 * share:.0f} % of the actions are at a limit; dearer increments (agent.planner.increment_weight=0.1) "
        "where the task does not need that"
    )


RULES: tuple[Callable[[Evidence], str | None], ...] = (
    _rare_rewards,
    _short_episodes,
    _flat_cost,
    _rare_cheap_steps,
    _leaves_the_range,
    _spread,
    _noise,
    _failures,
    _growing_mode,
    _unpredicted,
    _best_was_earlier,
    _still_falling,
    _saturated,
)
"""What matters most first: what no setting of the learning can mend comes before what more training may."""


def _cost(episodes: Sequence[Episode]) -> float:
    """Mean cost of an episode."""
    return float(np.mean([float(episode.costs.double().sum()) for episode in episodes]))


def _observations(episodes: Sequence[Episode]) -> Array | None:
    """All observations (K, N) that are numbers; None for frames, or where none was recorded."""
    if not episodes or episodes[0].observations.dim() != 2 or not episodes[0].observations.numel():
        return None
    seen = np.concatenate([episode.observations.numpy() for episode in episodes]).astype(np.float64)
    seen = seen[np.isfinite(seen).all(1)]
    return seen if len(seen) else None
