"""New episodes of a trained controller, as its latent model sees them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.buffer import Episode
from deepkoco.agent.collection import box_sizes, collect_episodes, episode_costs
from deepkoco.agent.exploration import OrnsteinUhlenbeck
from deepkoco.analysis.measures.steps import Steps, join_steps
from deepkoco.analysis.run_folder import TrainedRun
from deepkoco.envs.task_factory import make_task_factory
from deepkoco.koopman.latent_model import Array, LatentModel

NOISE_CORRELATION, NOISE_VARIANCE = 0.85, 0.85  # of the training's first episodes
MODERATE_NOISE = 0.3  # of its variance, about the middle of training


class ModelMismatchError(ValueError):
    """The model does not fit the task's observations or actions."""


def make_envs(run: TrainedRun, count: int, **kwargs: Any) -> VectorEnv:
    """Environments of the run's task, with other distractors than it was trained with.

    Args:
        run: The run.
        count: Environments.
        **kwargs: Further arguments of the environment, such as `render_mode`.

    Returns:
        The environments.

    Raises:
        TaskError: The stored task cannot be made here.
        ModelMismatchError: The model does not fit its observations or actions.
    """
    settings = run.settings
    make = make_task_factory(
        settings.task,
        settings.distractors,
        settings.observation,
        settings.distractor_options,
        split="evaluation",
        **kwargs,
    )
    envs = make(count, settings.seed)
    shape, low, _ = box_sizes(envs)
    history = run.model.make_history()
    wanted = (run.model.observation_size,) if history is None else history.observation_shape
    if tuple(shape) != wanted or low.size != run.action_low.size:
        raise ModelMismatchError(
            f"{run.path}: the model takes observations {wanted} and {run.action_low.size} actions, "
            f"{settings.task.id} has {tuple(shape)} and {low.size}; give the task it was trained on with --task"
        )
    return envs


def run_episodes(
    envs: VectorEnv,
    run: TrainedRun,
    model: LatentModel | None,
    seed: int,
    noise_variance: float = 0.0,
) -> list[Episode]:
    """One episode in every environment.

    Args:
        envs: B environments.
        run: Gives planner and limits.
        model: What plans; None moves by noise alone.
        seed: Of start states and noise; the same seed gives the same start states.
        noise_variance: Innovation variance of the exploration noise in units of the action limits squared.

    Returns:
        B episodes.
    """
    noise = None
    if noise_variance > 0.0:
        generator = torch.Generator().manual_seed(seed)
        noise = OrnsteinUhlenbeck(
            envs.num_envs, run.action_low.size, NOISE_CORRELATION, noise_variance, generator
        )
    agent = VectorAgent(model, run.planner, run.action_low, run.action_high, envs.num_envs, noise)
    return collect_episodes(envs, agent, seed)


def run_exploring(run: TrainedRun, count: int, seed: int) -> list[Episode]:
    """Episodes like those of the training: a third moved by noise alone, the others planned, with less noise.

    Args:
        run: The run.
        count: Episodes, at least 2.
        seed: Of everything.

    Returns:
        The episodes.
    """
    random = max(1, count // 3)
    # The training's variance is in squared units of the action; this makes it 1 for limits of +-2.
    scale = float(np.square(run.action_high - run.action_low).mean()) / 16.0
    episodes = []
    for number, size, model, variance in (
        (0, random, None, NOISE_VARIANCE),
        (1, count - random, run.model, MODERATE_NOISE * NOISE_VARIANCE),
    ):
        envs = make_envs(run, size)
        episodes += run_episodes(envs, run, model, seed + 1000 * number, variance * scale)
        envs.close()
    return episodes


def closed_loop_costs(envs: VectorEnv, run: TrainedRun, seed: int) -> Callable[[LatentModel], Array]:
    """From a model to the costs (B,) of noise-free episodes, from the same start states each time."""
    return lambda model: episode_costs(run_episodes(envs, run, model, seed))


def as_steps(run: TrainedRun, episodes: Sequence[Episode]) -> Steps:
    """Episodes as the latent model sees them: frames become features of the last d frames.

    Args:
        run: Gives the model.
        episodes: With observations or frames.

    Returns:
        Their steps.
    """
    return join_steps(
        [(_seen(run, e.observations.numpy()), e.actions.numpy(), e.costs.numpy()) for e in episodes]
    )


def _seen(run: TrainedRun, observations: np.ndarray) -> Array:
    history = run.model.make_history()
    if history is None:
        return observations
    return np.stack([history.push(frame) for frame in observations])
