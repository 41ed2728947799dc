"""Trainings of PPO on the pendulum with random delays: ours and that of stable-baselines3, with the same settings.

    python -m experiments.studies.learning.ppo_runs ours 0 result.json

Each is a process of its own, so that its processor time is all that it took: imports, compilation, training and
evaluations.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from baselines.ppo.config import PpoConfig
from baselines.ppo.training import PpoTrainer
from deepkoco.agent.collection import collect_episodes, cost_spread, episode_costs
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.agent.standing import Standing
from deepkoco.envs.task_factory import make_task_factory
from deepkoco.output.whole_file import write_whole_text
from deepkoco.runs.configs import CONFIGS
from deepkoco.runs.settings import ExperimentError, TaskConfig
from deepkoco.yaml_file import read_yaml

TASK = "pendulum_random_delay"
EPISODE_STEPS = 200
Curve = list[dict[str, float]]


def make_config(**changes: Any) -> PpoConfig:
    """The settings of both: those of configs/agent_on_task, without a comparison with references.

    Args:
        **changes: Of single settings.
    """
    stored = read_yaml(CONFIGS / "agent_on_task" / f"ppo_{TASK}.yaml")["agent"]
    return PpoConfig(**{**stored, "reference_episodes": 0, **changes})


def make_factory(**arguments: Any) -> Callable[[int, int], VectorEnv]:
    """The factory of the task's environments.

    Args:
        **arguments: In the place of those of configs/task.
    """
    stored = read_yaml(CONFIGS / "task" / f"{TASK}.yaml")
    return make_task_factory(TaskConfig(**{**stored, "kwargs": {**stored["kwargs"], **arguments}}))


def train_ours(seed: int, config: PpoConfig) -> tuple[dict[str, float], Curve]:
    """Train ours.

    Args:
        seed: Of the run.
        config: Hyper-parameters.

    Returns:
        What the final evaluation gave, and what every evaluation gave.
    """
    curve: Curve = []

    def tell(standing: Standing) -> None:
        if standing.row is not None:
            row = standing.row
            curve.append(_point(row["episodes"], row["train/cost"], row["evaluation/cost"]))

    with tempfile.TemporaryDirectory() as folder:
        last = PpoTrainer(make_factory(), config, seed, Path(folder)).run(tell)
    return _final(last["evaluation/cost"], last["evaluation/cost_sd"], last["episodes"]), curve


class TheirPolicy:
    """The mean action of a model of stable-baselines3 behind its scaled observations."""

    def __init__(self, model: Any, scaled: Any) -> None:
        self._model, self._scaled = model, scaled

    def reset(self) -> None:
        """Nothing is kept."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions (B, M) for observations (B, N)."""
        seen = self._scaled.normalize_obs(np.asarray(observations, np.float32))
        return self._model.predict(seen, deterministic=True)[0]


def train_theirs(seed: int, config: PpoConfig) -> tuple[dict[str, float], Curve]:
    """Train that of stable-baselines3, with `VecNormalize` for the scaling of observations and rewards.

    Its Gaussian is in the units of the action space, so it gets environments with actions of [-1, 1]. See `train_ours`
    for the rest.
    """
    try:
        from stable_baselines3 import PPO  # pyright: ignore[reportMissingImports]
        from stable_baselines3.common.callbacks import (  # pyright: ignore[reportMissingImports]
            BaseCallback,
        )
        from stable_baselines3.common.vec_env import (  # pyright: ignore[reportMissingImports]
            VecMonitor,
            VecNormalize,
        )

        from deepkoco.envs.stable_baselines import StableBaselinesEnv
    except ImportError as error:
        raise ExperimentError(
            'stable-baselines3 is not installed; get it with pip install -e ".[bench]"'
        ) from error
    evaluation = make_factory(action_units="normalized")
    envs: Any = make_factory(action_units="normalized", autoreset_mode="SameStep")(config.environments, seed)
    scaled = VecNormalize(
        VecMonitor(StableBaselinesEnv(envs)), gamma=config.discount, clip_obs=config.observation_limit,
        clip_reward=config.reward_limit, norm_obs=config.scale_observations, norm_reward=config.scale_rewards,
    )  # fmt: skip
    model = PPO(
        "MlpPolicy", scaled, learning_rate=config.learning_rate, n_steps=config.steps, batch_size=config.minibatch,
        n_epochs=config.epochs, gamma=config.discount, gae_lambda=config.trace_decay, clip_range=config.ratio_clip,
        ent_coef=config.entropy_weight, vf_coef=config.value_weight, max_grad_norm=config.gradient_limit,
        target_kl=config.divergence_limit,
        policy_kwargs={"net_arch": list(config.hidden), "log_std_init": config.log_sigma}, seed=seed, device="cpu",
        stats_window_size=config.evaluation_every,
    )  # fmt: skip
    policy, curve = TheirPolicy(model, scaled), []

    def evaluate(count: int, purpose: Purpose) -> np.ndarray:
        own = evaluation(count, seed)
        return episode_costs(collect_episodes(own, policy, derive_seed(seed, purpose), record=False))

    class Evaluating(BaseCallback):
        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            episodes = self.num_timesteps // EPISODE_STEPS
            if episodes % config.evaluation_every == 0 and episodes < config.total_episodes:
                add(episodes, evaluate(config.evaluation_episodes, Purpose.EVALUATION))

    def add(episodes: int, costs: np.ndarray) -> None:
        trained = np.mean([-float(episode["r"]) for episode in model.ep_info_buffer or ()])
        curve.append(_point(episodes, float(trained), float(costs.mean())))

    model.learn(config.total_episodes * EPISODE_STEPS, callback=Evaluating())
    last = evaluate(config.final_evaluation_episodes, Purpose.FINAL_EVALUATION)
    add(config.total_episodes, last)
    return _final(float(last.mean()), cost_spread(last), config.total_episodes), curve


@dataclass(frozen=True)
class Method:
    """What is trained.

    Attributes:
        train: From a seed and settings to the final evaluation and all evaluations.
        changes: Of the settings.
    """

    train: Callable[[int, PpoConfig], tuple[dict[str, float], Curve]]
    changes: Mapping[str, Any] = field(default_factory=dict)


WITHOUT_LIMIT = {"divergence_limit": None, "total_episodes": 2560}
METHODS = {
    "ours": Method(train_ours),
    "stable_baselines3": Method(train_theirs),
    "ours_without_limit": Method(train_ours, WITHOUT_LIMIT),
    "stable_baselines3_without_limit": Method(train_theirs, WITHOUT_LIMIT),
}


def _point(episodes: float, training: float, evaluation: float) -> dict[str, float]:
    return {
        "episodes": float(episodes),
        "training_cost": training,
        "evaluation_cost": evaluation,
        "cpu_seconds": time.process_time(),
    }


def _final(cost: float, spread: float, episodes: float) -> dict[str, float]:
    return {"cost": cost, "cost_sd": spread, "episodes": float(episodes)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Train once and write the result as JSON; returns the exit status."""
    parser = argparse.ArgumentParser(description="Train PPO once on the pendulum with random delays.")
    parser.add_argument("method", choices=list(METHODS))
    parser.add_argument("seed", type=int)
    parser.add_argument("out", type=Path, help="new file")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    try:
        method = METHODS[args.method]
        final, curve = method.train(args.seed, make_config(**method.changes))
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    write_whole_text(args.out, json.dumps({**final, "curve": curve}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
