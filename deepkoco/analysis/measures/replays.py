"""The true system under planned actions: an episode is gone through again up to the plan, then follows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium.vector import VectorEnv

from deepkoco.agent.policy import KoopmanPolicy
from deepkoco.analysis.measures.plans import Plan, make_plan
from deepkoco.koopman.latent_model import Array
from deepkoco.planning import PlannerConfig, make_planner


class ReplayError(RuntimeError):
    """The environment cannot be drawn, or does not do the same again under the same seed and actions."""


@dataclass(frozen=True)
class FilmedEpisode:
    """One episode of the controller with everything that is drawn.

    Attributes:
        seed: Of its reset.
        observations: What the environment gave at each step (L, ...).
        actions: a_k (L, M).
        costs: c_k (L,).
        plans: Made at each step.
        frames: What the environment shows, distractors included, uint8 (L, height, width, 3).
        scenes: The same without distractors; their height and width are not larger.
    """

    seed: int
    observations: np.ndarray
    actions: Array
    costs: Array
    plans: Sequence[Plan]
    frames: Sequence[np.ndarray]
    scenes: Sequence[np.ndarray]


@dataclass(frozen=True)
class Future:
    """What the true system does under one plan.

    Attributes:
        costs: Of steps 1 .. H of the plan, as many as the episode has (h,).
        scenes: Pictures at the asked steps, without distractors.
    """

    costs: Array
    scenes: Sequence[np.ndarray]


def film_episode(
    envs: VectorEnv,
    policy: KoopmanPolicy,
    config: PlannerConfig,
    low: Array,
    high: Array,
    seed: int,
    most: int,
) -> FilmedEpisode:
    """Run the controller for one episode and note its plans.

    Args:
        envs: One environment with the render mode `rgb_array`.
        policy: The controller.
        config: Its planner's settings.
        low, high: Action limits (M,).
        seed: Of the reset.
        most: Longest film [steps].

    Returns:
        The episode.
    """
    planner = make_planner(policy.model, config, low, high)
    history = policy.model.make_history()
    policy.reset()
    observation, _ = envs.reset(seed=seed)
    observations, actions, costs, plans, frames, scenes = [], [], [], [], [], []
    ended = False
    while not ended and len(costs) < most:
        frames.append(_picture(envs))
        scenes.append(_picture(envs.unwrapped))
        action = policy.act(observation[0]).astype(np.float64)
        seen = observation[0].astype(np.float64) if history is None else history.push(observation[0])
        plans.append(make_plan(policy.model, planner, config.horizon, seen, action))
        observations.append(np.array(observation[0]))
        actions.append(action)
        observation, reward, terminated, truncated, _ = envs.step(_typed(envs, action))
        costs.append(-float(reward[0]))
        ended = bool(terminated[0] or truncated[0])
    return FilmedEpisode(
        seed, np.stack(observations), np.stack(actions), np.array(costs), plans, frames, scenes
    )


def follow_plan(envs: VectorEnv, episode: FilmedEpisode, step: int, pictures: Sequence[int] = ()) -> Future:
    """Go through an episode again up to a step and follow the plan made there.

    Args:
        envs: One environment of the same kind.
        episode: To repeat.
        step: k, where the plan was made.
        pictures: Steps of the plan, 1 .. H ascending, of which pictures are wanted.

    Returns:
        The future under the plan; shorter where the episode ends.

    Raises:
        ReplayError: The environment was not where it had been at step k.
    """
    observation, _ = envs.reset(seed=episode.seed)
    for action in episode.actions[:step]:
        observation, *_ = envs.step(_typed(envs, action))
    if not np.array_equal(observation[0], episode.observations[step]):
        raise ReplayError(
            f"step {step} of the episode with seed {episode.seed} is not repeated by the same actions; "
            "the environment draws from a generator that its reset does not seed"
        )
    costs, scenes = [], []
    plan = [episode.actions[step], *episode.plans[step].actions]
    for h, action in enumerate(plan):
        if h in pictures:
            scenes.append(_picture(envs.unwrapped))
        _, reward, terminated, truncated, _ = envs.step(_typed(envs, action))
        if h > 0:
            costs.append(-float(reward[0]))
        if terminated[0] or truncated[0]:
            break
    return Future(np.array(costs), scenes)


def _typed(envs: VectorEnv, action: Array) -> np.ndarray:
    # As float32 first: that is what the controller sends.
    return action[None].astype(np.float32).astype(envs.single_action_space.dtype)


def _picture(envs: VectorEnv) -> np.ndarray:
    try:
        frames = envs.render()
    # An environment finds out only now that it lacks a package, or that it has no `render` at all.
    except Exception as error:
        reason = f"{type(error).__name__}: {error}" if str(error) else "it has no render()"
        raise ReplayError(f"the environment cannot be drawn: {reason}") from error
    if frames is None or frames[0] is None:
        raise ReplayError("the environment cannot be drawn: it gives no pictures")
    return np.asarray(frames[0])
