"""A small training run in its own process: python small_run.py FOLDER."""

import sys
from pathlib import Path

import gymnasium
import torch
from gymnasium.vector import VectorEnv

from deepkoco.agent import Trainer, TrainingConfig
from deepkoco.koopman import ModelConfig
from deepkoco.planning import PlannerConfig


def make_envs(count: int, seed: int) -> VectorEnv:
    return gymnasium.make_vec("Pendulum-v1", num_envs=count, vectorization_mode="sync", max_episode_steps=45)


def small_config() -> TrainingConfig:
    return TrainingConfig(
        model=ModelConfig(2, 0.05, (8, 8), (8,)),
        planner=PlannerConfig(5),
        first_episodes=6,
        first_epochs=40,
        iteration_episodes=4,
        iteration_updates=20,
        total_episodes=30,
        horizon=5,
        chunks=2,
        chunk_length=15,
        evaluation_episodes=2,
        final_evaluation_episodes=3,
        checkpoint_updates=50,
        scale=False,  # what is learned can then be compared with what is exported
        relative_cost=0.0,
    )


if __name__ == "__main__":
    torch.set_num_threads(1)
    folder = Path(sys.argv[1])
    folder.mkdir(exist_ok=True)
    Trainer(make_envs, small_config(), 7, folder).run()
