"""The episodes of the first iteration: noise alone, then EDMDc with the planner and noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from deepkoco.agent.action_cost import measure_action_cost
from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.buffer import Episode
from deepkoco.agent.collection import collect_episodes, episode_costs
from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.exploration import OrnsteinUhlenbeck, action_units
from deepkoco.agent.fitted_settings import fitted, linear_horizon, often_ended
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.agent.task_scale import TaskScale, lowest_cost, with_end
from deepkoco.koopman.exported import Array
from deepkoco.koopman.lifting.episode_fit import fit_best_to_episodes
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel, LiftedModelError
from deepkoco.planning.config import PlannerConfig

TRIALS = 6
"""First planned episodes, which tell whether the linear model is worth going on with."""
CALM_ROUNDS = 3


def random_count(config: TrainingConfig) -> int:
    """Episodes of the first iteration that are moved by noise alone."""
    return max(1, round(config.first_episodes * (1.0 - config.warm_start)))


def task_units(config: TrainingConfig, episodes: Sequence[Episode], low: Array, high: Array) -> TaskScale:
    """The units that a task is learned in.

    Args:
        config: Hyper-parameters, as `fitted` leaves them.
        episodes: Of the first iteration, those of noise alone first: they show what actions cost.
        low: a_min (M,).
        high: a_max (M,).
    """
    cost = None
    # A value of actions knows what they cost; R would charge it again, and at every step in full.
    measured = config.measure_action_cost and not config.value.discount
    if measured and episodes[0].observations.dim() == 2:
        cost = measure_action_cost(episodes[: random_count(config)])
    return TaskScale.of(episodes, low, high, cost, config.cost_discount)


def calm_rounds(config: TrainingConfig, first: Sequence[Episode]) -> tuple[float, int, bool]:
    """How calm exploration has to be so that its episodes show a training window of the task.

    Noise that fells a pole in four steps leaves nothing to learn from. Where the task ended most random episodes
    before a window was over, rounds of `TRIALS` further ones are moved by noise from as bold as theirs down to a floor,
    which falls from round to round until the calmest episode is as long as a window, or no longer than before.

    Args:
        config: Hyper-parameters.
        first: Episodes of the first iteration so far, those of noise alone first. Of a finished one too: what was
            decided follows from what was seen.

    Returns:
        Noise of the calmest environment as a share of the boldest's, how many of the episodes noise alone has moved,
        and whether another round is wanted.
    """
    alone, floor = min(random_count(config), len(first)), config.noise_floor
    if floor == 1.0 or not often_ended(first[:alone]):
        return 1.0, alone, False
    longest = float(np.median([episode.costs.numel() for episode in first[:alone]]))
    for _ in range(CALM_ROUNDS):
        if longest > config.horizon:
            break
        if alone + TRIALS > len(first):
            return floor, alone, True
        alone += TRIALS
        length = first[alone - 1].costs.numel()
        if length > config.horizon or length <= longest:
            break
        longest, floor = float(length), floor * config.noise_floor
    return floor, alone, False


def make_noise(
    config: TrainingConfig,
    count: int,
    floor: float,
    variance: float,
    low: Array,
    high: Array,
    generator: torch.Generator,
) -> OrnsteinUhlenbeck:
    """Exploration of a batch of environments.

    Args:
        config: Hyper-parameters.
        count: B.
        floor: Noise of the calmest environment as a share of the boldest's; see `calm_rounds`.
        variance: sigma^2 of this iteration.
        low: a_min (M,).
        high: a_max (M,).
        generator: Source of every draw.
    """
    unit = action_units(config.noise_unit, torch.from_numpy(low), torch.from_numpy(high))
    return OrnsteinUhlenbeck(count, low.size, config.noise_correlation, variance, generator, unit, floor)


def planner_of_linear(planner: PlannerConfig, horizon: int | None = None) -> PlannerConfig:
    """The same planner for a linear model, which has no decoder to plan along a trajectory with, and no need for it.

    Args:
        planner: Of the networks.
        horizon: H, see `linear_horizon`; None leaves it.
    """
    return replace(planner, method="lmpc", linearisation="frozen", horizon=horizon or planner.horizon)


def fit_linear(
    episodes: Sequence[Episode],
    time_step: float,
    action_weight: float | Array,
    horizon: int,
    seed: int,
    relative: float | None = None,
    units: TaskScale | None = None,
) -> LiftedLinearModel:
    """EDMDc of recorded episodes.

    Args:
        episodes: With observations that are states.
        time_step: Seconds per step.
        action_weight: R, one for all actions or one each (M,).
        horizon: H.
        seed: Of its draws.
        relative: See `fit_to_episodes`.
        units: Their discount says whether the cost is that of a step or a mean of those to come; None: of a step.

    Returns:
        The model.

    Raises:
        LiftedModelError: The episodes do not suffice, or a number is not finite.
    """
    if units is not None and units.discount:
        lowest, ended = units.lowest, [units.with_costs_to_come(episode) for episode in episodes]
    else:
        lowest = lowest_cost(episodes)
        ended = [with_end(episode, lowest, 1) for episode in episodes]
    whole = [e for e in ended if e.costs.numel() > 1 and bool(e.observations.isfinite().all())]
    if not whole:
        raise LiftedModelError("no first episode has two steps of finite observations")
    observations, actions, costs = (
        [getattr(episode, name).double().numpy() for episode in whole]
        for name in ("observations", "actions", "costs")
    )
    costs = [np.maximum(part - lowest, 0.0) for part in costs]
    try:
        return fit_best_to_episodes(
            observations,
            actions,
            costs,
            time_step,
            action_weight,
            horizon,
            np.random.default_rng(seed),
            relative,
        )
    except np.linalg.LinAlgError as error:
        raise LiftedModelError(str(error)) from error


def collect_first(
    config: TrainingConfig,
    envs: Callable[[int], VectorEnv],
    low: Array,
    high: Array,
    noise: Callable[[int, float], OrnsteinUhlenbeck],
    run_seed: int,
) -> tuple[list[Episode], int]:
    """Collect the episodes of the first iteration.

    Noise alone takes a cart that nothing holds 15 times as far as its task; the planner on a linear model of these
    episodes comes back, so that there is something to learn from where the task is. Where the first planned episodes
    are not clearly cheaper, as on a swing-up, which no linear model masters, noise alone goes on.

    Args:
        config: Hyper-parameters.
        envs: Environments by number.
        low: a_min (M,).
        high: a_max (M,).
        noise: Makes the exploration of so many environments with such a floor.
        run_seed: Seed of the run.

    Returns:
        The episodes, those of noise alone first, and the plans that could not be made.
    """
    count = min(config.first_episodes, config.total_episodes)
    random = min(count, random_count(config))
    agent = VectorAgent(None, config.planner, low, high, random, noise(random, 1.0))
    # Numbers beyond those of all iterations, whose start states these must not be.
    seeds = [derive_seed(run_seed, Purpose.TRAINING_EPISODES, number) for number in (0, 2**20, 2**20 + 1)]
    episodes = collect_episodes(envs(random), agent, seeds[0])
    floor, alone, wanted = calm_rounds(config, episodes)
    while wanted and alone + TRIALS <= count:
        agent = VectorAgent(None, config.planner, low, high, TRIALS, noise(TRIALS, floor))
        seed = derive_seed(run_seed, Purpose.TRAINING_EPISODES, 2**21 + alone)
        episodes += collect_episodes(envs(TRIALS), agent, seed)
        floor, alone, wanted = calm_rounds(config, episodes)
    random, config = alone, fitted(config, episodes)
    linear, failures = None, 0
    planner = planner_of_linear(config.planner, linear_horizon(config))
    if random < count and episodes[0].observations.dim() == 2:
        weight: float | Array = config.model.action_weight
        units = task_units(config, episodes, low, high) if config.scale else None
        if units is not None:
            weight = units.of_steps.action_weight(config.model.action_weight)
            planner = units.of_steps.planner(planner)
        with suppress(LiftedModelError):
            linear = fit_linear(
                episodes,
                config.model.time_step,
                weight,
                planner.horizon,
                seeds[1],
                config.relative_cost or None,
                units,
            )
    for number, left in enumerate((min(TRIALS, count - random), count - random - TRIALS)):
        if left <= 0:
            break
        agent = VectorAgent(linear, planner, low, high, left, noise(left, floor))
        planned = collect_episodes(envs(left), agent, seeds[1 + number])
        if not _clearly_cheaper(planned, episodes[:random]):
            linear = None
        episodes += planned
        failures += agent.failures
    return episodes, failures


def _clearly_cheaper(some: Sequence[Episode], others: Sequence[Episode]) -> bool:
    """Whether the mean cost of episodes is below that of others by more than two standard errors of the difference."""
    costs = [episode_costs(list(episodes)) for episodes in (some, others)]
    error = sum(float(c.var(ddof=1)) / c.size if c.size > 1 else np.inf for c in costs) ** 0.5
    return float(costs[0].mean() - costs[1].mean()) < -2.0 * error
