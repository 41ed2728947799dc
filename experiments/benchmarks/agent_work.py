"""The work that a training run of an agent consists of, in parts that can be timed alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from baselines.collection import EpisodeRound
from baselines.config import BaselineConfig
from baselines.policy import BaselinePolicy
from baselines.ppo.collection import Collector
from baselines.ppo.config import PpoConfig
from baselines.ppo.learner import PpoLearner
from baselines.ppo.networks import ActorCritic
from baselines.ppo.policy import PpoPolicy
from baselines.ppo.scaling import ScaledRewards
from baselines.registry import make_learner
from baselines.replay import Replay
from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.buffer import EpisodeBuffer
from deepkoco.agent.collection import BatchController, box_sizes, collect_episodes
from deepkoco.agent.exploration import OrnsteinUhlenbeck
from deepkoco.agent.learner import Learner
from deepkoco.koopman.export import export_model
from deepkoco.runs.environments import make_environments
from deepkoco.runs.settings import TrainRunConfig
from experiments.benchmarks.training_benchmark import updates_of_a_run

UPDATES_A_CALL = 10
FILLED_EPISODES = 5  # of a baseline's replay, before its updates are timed


@dataclass(frozen=True)
class Part:
    """One kind of work.

    Attributes:
        call: Does some of it.
        units: How many a call does: updates, or environment steps.
        of_a_seed: How many a whole run does.
    """

    call: Callable[[], object]
    units: int
    of_a_seed: int


def deepkoco_parts(config: TrainRunConfig, episode_steps: int) -> dict[str, Part]:
    """The parts of DeepKoCo's training.

    Args:
        config: Settings of the run.
        episode_steps: Of every episode.

    Returns:
        By name; "update" is among them.
    """
    agent = config.agent
    envs = make_environments(config)(agent.iteration_episodes, config.seed)
    observation, low, high = box_sizes(envs)
    learner = Learner(observation, low.size, agent)
    buffer = EpisodeBuffer(1 if learner.model.frame_encoder is None else agent.model.frames)
    generator = torch.Generator().manual_seed(0)

    def walker(model) -> VectorAgent:
        noise = OrnsteinUhlenbeck(
            envs.num_envs, low.size, agent.noise_correlation, agent.noise_variance, generator
        )
        return VectorAgent(model, agent.planner, low, high, envs.num_envs, noise)

    idle, planning = walker(None), walker(export_model(learner.averaged))
    buffer.add(collect_episodes(envs, idle, 0))

    def update() -> None:
        for _ in range(UPDATES_A_CALL):
            batch = buffer.sample(
                agent.chunks, agent.chunk_length, agent.horizon, generator, agent.window_stride
            )
            learner.update(batch)

    later = max(0, agent.total_episodes - agent.first_episodes)
    iterations = -(-later // agent.iteration_episodes)
    evaluations = iterations + (agent.keep == "best")  # the last weights are compared with the others first
    planned = later + evaluations * agent.evaluation_episodes + agent.final_evaluation_episodes
    steps = envs.num_envs * episode_steps
    first = min(agent.first_episodes, agent.total_episodes) * episode_steps
    return {
        "update": Part(update, UPDATES_A_CALL, updates_of_a_run(config, episode_steps)),
        "step by noise": Part(lambda: collect_episodes(envs, idle, 0), steps, first),
        "step with a plan": Part(lambda: collect_episodes(envs, planning, 0), steps, planned * episode_steps),
    }


def baseline_parts(config: TrainRunConfig, episode_steps: int) -> dict[str, Part]:
    """The parts of a baseline's training; see `deepkoco_parts`."""
    agent: BaselineConfig = config.agent
    make = make_environments(config)
    envs = make(agent.environments, config.seed)
    shape, low, high = box_sizes(envs)
    learner = make_learner(shape, low.size, agent)
    frames = agent.frames if len(shape) == 3 else 1
    replay, generator = Replay(shape, low.size, frames), torch.Generator().manual_seed(0)

    def episode(random: bool) -> None:
        walk = EpisodeRound(envs, replay, shape, frames, low, high)
        walk.start(0)
        while walk.running.any():
            walk.step(learner, generator, random)

    for _ in range(FILLED_EPISODES):
        episode(random=True)

    def update() -> None:
        for _ in range(UPDATES_A_CALL):
            learner.update(replay.sample(agent.batch, generator), generator)

    steps = agent.total_episodes * episode_steps
    random_steps = min(agent.random_steps, steps)
    evaluations = (agent.total_episodes - 1) // agent.evaluation_every  # the last one is the final one
    evaluated = evaluations * agent.evaluation_episodes + agent.final_evaluation_episodes
    count = max(agent.evaluation_episodes, 1)
    policy = BaselinePolicy(learner.actor, learner.critic, shape, frames, low, high)
    evaluation = make(count, config.seed)
    return {
        "update": Part(update, UPDATES_A_CALL, (steps - random_steps) // agent.steps_per_update),
        "random step": Part(lambda: episode(random=True), envs.num_envs * episode_steps, random_steps),
        "step": Part(lambda: episode(random=False), envs.num_envs * episode_steps, steps - random_steps),
        "evaluation step": Part(
            lambda: _evaluate(evaluation, policy), count * episode_steps, evaluated * episode_steps
        ),
    }


def ppo_parts(config: TrainRunConfig, episode_steps: int) -> dict[str, Part]:
    """The parts of PPO's training, whose rollouts begin at resets; see `deepkoco_parts`."""
    agent: PpoConfig = config.agent
    make = make_environments(config)
    envs = make(agent.environments, config.seed)
    (size, *_), low, high = box_sizes(envs)
    learner = PpoLearner(ActorCritic(size, low, high, agent), agent)
    rewards = ScaledRewards(agent.environments, agent.discount, agent.reward_limit, agent.scale_rewards)
    collector = Collector(envs, learner.networks, rewards, agent)
    generator = torch.Generator().manual_seed(0)
    collector.start(0)
    _, samples = collector.run(generator)

    def update() -> None:
        learner.update(samples, [torch.randperm(len(samples), generator=generator)])

    def rollout() -> None:
        collector.start(0)
        collector.run(generator)

    minibatches = -(-len(samples) // agent.minibatch)
    rollouts = -(-agent.total_episodes // agent.environments) * -(-episode_steps // agent.steps)
    rounds = -(-agent.total_episodes // agent.environments)
    evaluations = min((agent.total_episodes - 1) // agent.evaluation_every, rounds - 1)
    evaluated = evaluations * agent.evaluation_episodes + agent.final_evaluation_episodes
    count = max(agent.evaluation_episodes, 1)
    evaluation, policy = make(count, config.seed), PpoPolicy(learner.networks)
    steps = agent.environments * agent.steps
    return {
        "update": Part(update, minibatches, rollouts * agent.epochs * minibatches),
        "step": Part(rollout, steps, rollouts * steps),
        "evaluation step": Part(
            lambda: _evaluate(evaluation, policy), count * episode_steps, evaluated * episode_steps
        ),
    }


def _evaluate(envs: VectorEnv, policy: BatchController) -> None:
    collect_episodes(envs, policy, 0, record=False)


def count_steps(config: TrainRunConfig) -> int:
    """Steps of an episode, of one that is played."""
    envs = make_environments(config)(1, config.seed)
    _, low, high = box_sizes(envs)
    envs.reset(seed=0)
    action, steps, ended = np.atleast_2d(0.5 * (low + high)).astype(np.float32), 0, False
    while not ended:
        _, _, terminated, truncated, _ = envs.step(action)
        steps, ended = steps + 1, bool((terminated | truncated).any())
    envs.close()
    return steps


PARTS: dict[str, Callable[[TrainRunConfig, int], dict[str, Part]]] = {
    "deepkoco": deepkoco_parts,
    "sac": baseline_parts,
    "sac_shared": baseline_parts,
    "deepmdp": baseline_parts,
    "dbc": baseline_parts,
    "ppo": ppo_parts,
}
"""How the work of each agent is made, by its name."""
