"""A small training run on frames in its own process: python small_image_run.py FOLDER."""

import sys
from pathlib import Path
from typing import cast

import gymnasium
import torch
from gymnasium.vector import VectorEnv
from small_run import small_config

from deepkoco.agent import Trainer, TrainingConfig
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.pixels import VectorPixels
from deepkoco.koopman import ModelConfig

EPISODE_STEPS = 30


def make_image_envs(count: int, seed: int) -> VectorEnv:
    envs = gymnasium.make_vec("deepkoco/RodPendulum-v0", count, vectorization_mode="vector_entry_point")
    cast(GraphVectorEnv, envs.unwrapped).plan_episodes(EPISODE_STEPS)
    return VectorPixels(envs)


def image_config() -> TrainingConfig:
    config = small_config()
    config.model = ModelConfig(2, 0.05, (8, 8), (8,), frame_features=4, frame_channels=(4, 4))
    config.first_epochs, config.total_episodes, config.checkpoint_updates = 8, 14, 15
    return config


if __name__ == "__main__":
    torch.set_num_threads(1)
    folder = Path(sys.argv[1])
    folder.mkdir(exist_ok=True)
    Trainer(make_image_envs, image_config(), 7, folder).run()
