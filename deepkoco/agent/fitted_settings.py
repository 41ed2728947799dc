"""Settings of the learning as the first episodes of a task call for them: how far costs and windows have to look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.agent.buffer import Episode
from deepkoco.agent.config import TrainingConfig
from deepkoco.koopman.exported import Array
from deepkoco.planning.config import PlannerConfig

CHEAP_STEPS, MARGIN = 0.2, 0.1
"""Rewards are rare where fewer than this share of the steps cost less than the dearest, by this share of the range."""
VISIBLE = 0.1
"""Rewards are out of sight where fewer than this share of the windows show that costs differ, by `MARGIN`."""
CALMEST = 6
"""Last random episodes, which calm noise has moved where bold noise ended them early."""
SHORTEST = 3
"""Least T [steps]."""


def fitted(config: TrainingConfig, random: Sequence[Episode]) -> TrainingConfig:
    """Settings that fit what noise alone has shown.

    Args:
        config: As given.
        random: Episodes that noise alone has moved, the calmest ones last.

    Returns:
        The same but for `cost_discount`, `horizon` and the planner's horizon.
    """
    horizon = fitted_horizon(config, random) if config.fit_horizon else config.horizon
    short = horizon < config.horizon
    sees_far = bool(config.cost_discount or config.value.discount)
    far = config.scale and not sees_far and (short or out_of_sight(random, config.horizon))
    if short:
        planned = max(2, round(config.planner.horizon * horizon / config.horizon))
        config = replace(config, horizon=horizon, planner=replace(config.planner, horizon=planned))
    return replace(config, cost_discount=config.rare_discount) if far else config


def linear_horizon(config: TrainingConfig) -> int:
    """H of a linear model: that of the settings, but not less than the default where a value of actions sees so far.

    A linear model has no such value, and a plan of one step would not be a fair one.

    Args:
        config: As `fitted` leaves it.
    """
    own = config.planner.horizon
    return max(own, PlannerConfig().horizon) if config.value.discount else own


def often_ended(random: Sequence[Episode]) -> bool:
    """Whether the task itself ended most random episodes: noise as bold as theirs then shows hardly anything else."""
    return sum(episode.final is not None for episode in random) > 0.5 * len(random)


def fitted_horizon(config: TrainingConfig, random: Sequence[Episode]) -> int:
    """T that the episodes have room for.

    Where even calm noise is usually followed by an end before one window is over, windows of what was seen end so,
    whatever the actions. What the last steps of a plan cost is then no guide. With windows of half an episode the first
    half of every episode shows some that go on, and how soon an end comes is what the costs to come tell.

    Args:
        config: As given.
        random: Episodes that noise alone has moved, the calmest ones last.
    """
    if (
        not often_ended(random) or config.window_stride > 1
    ):  # windows that do not overlap are as long as a chunk
        return config.horizon
    lengths = [episode.costs.numel() for episode in random]
    usual = int(max(np.median(lengths), np.median(lengths[-CALMEST:])))
    return config.horizon if usual > config.horizon else max(SHORTEST, (usual + 1) // 2)


def out_of_sight(random: Sequence[Episode], horizon: int) -> bool:
    """Whether hardly any window of the random episodes shows a reward.

    Nothing that is planned over such a window can lead to where the task pays. Costs that are rare and high are another
    matter: most steps then show what is cheap. Costs that are not finite are left out.

    Args:
        random: Episodes that noise alone has moved.
        horizon: T.
    """
    parts = [episode.costs.double().numpy() for episode in random]
    costs = np.concatenate(parts)
    costs = costs[np.isfinite(costs)]
    if not costs.size:
        return False
    lowest, usual, highest = np.quantile(costs, [0.0, CHEAP_STEPS, 1.0])
    margin = MARGIN * (highest - lowest)
    if margin <= 0.0 or usual <= highest - margin:
        return False
    long = [part for part in parts if part.size > horizon]
    differ = np.concatenate([_ranges(part, horizon) > margin for part in long] or [np.zeros(0, bool)])
    return bool(differ.size) and float(differ.mean()) < VISIBLE


def _ranges(costs: Array, horizon: int) -> Array:
    """Range of the finite costs of every window of T + 1 steps; -inf where there is none."""
    known = np.isfinite(costs)
    highest, lowest = (
        np.lib.stride_tricks.sliding_window_view(np.where(known, costs, unknown), horizon + 1)
        for unknown in (-np.inf, np.inf)
    )
    return highest.max(1) - lowest.min(1)
