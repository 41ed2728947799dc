"""Plans of the controller against what came true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.analysis.measures.steps import Steps
from deepkoco.koopman.latent_model import Array, LatentModel
from deepkoco.output.colours import COLOURS
from deepkoco.output.picture import Picture
from deepkoco.planning import Planner, make_planner
from deepkoco.planning.config import PlannerConfig

SHOWN_POINTS = 3000


@dataclass(frozen=True)
class Plan:
    """One plan.

    Attributes:
        actions: Planned a_1 .. a_H (H, M); a_0 is the present one.
        costs: Predicted costs of steps 0 .. H (H + 1,); step 0 is the present.
    """

    actions: Array
    costs: Array


def make_plan(model: LatentModel, planner: Planner, horizon: int, observation: Array, action: Array) -> Plan:
    """Plan from one point and predict its cost.

    Args:
        model: The latent model.
        planner: Of this model.
        horizon: H of the planner.
        observation: (N,).
        action: Present action (M,).

    Returns:
        The plan with the cost the model expects of it.
    """
    rows, factor = model.linearise(observation, action)
    increment = planner.plan(rows, factor, action)
    planned = planner.planned
    if planned is None:  # the first plan of an episode failed: nothing is planned but to hold the action
        planned = np.tile(action, (horizon, 1))
    increments = np.vstack([increment, np.diff(planned, axis=0)])
    actions = np.vstack([action, action + np.cumsum(increments, axis=0)])
    latent, latents = np.ascontiguousarray(rows[0]), [rows[0]]
    for step in increments:
        latent = model.dynamics.advance(latent) + step @ rows[1:]
        latents.append(latent)
    readout = np.stack(latents) @ factor.T
    costs = np.square(readout).sum(-1) + (model.action_weight * np.square(actions)).sum(-1)
    return Plan(actions[1:], costs)


@dataclass(frozen=True)
class PlannedCosts:
    """Sums of cost over the H steps after each step that has so many.

    Attributes:
        planned: Expected when planning (K,).
        realised: Paid by the controller, which plans anew at each step (K,).
        episode: Number of the episode (K,).
        step: Step within it (K,).
    """

    planned: Array
    realised: Array
    episode: Array
    step: Array


def planned_costs(
    model: LatentModel, config: PlannerConfig, low: Array, high: Array, steps: Steps
) -> PlannedCosts:
    """Plan again at every recorded step of noise-free episodes.

    Args:
        model: The latent model that acted.
        config: The planner's settings.
        low, high: Action limits (M,).
        steps: Recorded steps.

    Returns:
        Planned and realised costs.
    """
    planner = make_planner(model, config, low, high)
    planned, realised, episodes, places = [], [], [], []
    for number, (start, length) in enumerate(zip(steps.starts, steps.lengths, strict=True)):
        planner.reset()
        total = np.concatenate([[0.0], np.cumsum(steps.costs[start : start + length])])
        for k in range(length - config.horizon):
            plan = make_plan(
                model, planner, config.horizon, steps.observations[start + k], steps.actions[start + k]
            )
            planned.append(plan.costs[1:].sum())
            realised.append(total[k + config.horizon + 1] - total[k + 1])
            episodes.append(number)
            places.append(k)
    return PlannedCosts(*(np.array(values, np.float64) for values in (planned, realised, episodes, places)))


def draw_planned_costs(costs: PlannedCosts, horizon: int, time_step: float) -> Picture:
    """Scatter over all steps, and both curves over the median episode."""
    figure = Figure(figsize=(9.0, 3.8))
    left, right = figure.subplots(1, 2)
    stride = max(1, costs.planned.size // SHOWN_POINTS)
    left.scatter(
        costs.planned[::stride], costs.realised[::stride], s=5, color=COLOURS["DeepKoCo"], alpha=0.4,
        linewidths=0, rasterized=True,
    )  # fmt: skip
    top = float(np.quantile(np.concatenate([costs.planned, costs.realised]), 0.995)) * 1.05
    left.plot([0.0, top], [0.0, top], color=COLOURS["measured"], linewidth=0.8)
    left.set(
        xlabel=f"cost planned for the next {horizon} steps",
        ylabel="cost realised",
        xlim=(0, top),
        ylim=(0, top),
    )
    totals = [costs.realised[costs.episode == e].sum() for e in np.unique(costs.episode)]
    median = np.unique(costs.episode)[np.argsort(totals)[len(totals) // 2]]
    mine = costs.episode == median
    time = costs.step[mine] * time_step
    right.plot(time, costs.planned[mine], color=COLOURS["DeepKoCo"], label="planned")
    right.plot(time, costs.realised[mine], color=COLOURS["measured"], label="realised")
    right.set(xlabel="time in the episode [s]", ylabel=f"cost of the next {horizon} steps", ylim=(0, None))
    right.legend()
    gap = costs.realised - costs.planned
    correlation = (
        float(np.corrcoef(costs.planned, costs.realised)[0, 1]) if costs.planned.size > 2 else float("nan")
    )
    caption = (
        f"At every step the planner expects a cost for the next {horizon} steps; realised is what was then paid by "
        "the controller, which makes a new plan at every step and so need not follow the old one. On average "
        f"realised minus planned is {gap.mean():+.3g} (root mean square {np.sqrt(np.square(gap).mean()):.3g}), their "
        f"correlation is {correlation:.3f}; right, one episode of middling cost."
    )
    table = pd.DataFrame(
        {
            "episode": costs.episode.astype(int),
            "step": costs.step.astype(int),
            "planned": costs.planned,
            "realised": costs.realised,
        }
    )
    return Picture("planned_cost", "Does the plan come true?", caption, figure, table)
