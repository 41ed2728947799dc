"""Folders of small models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from deepkoco.agent.stored_controller import StoredController, write_controller
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.planning import PlannerConfig

TASK = {"name": "pendulum", "id": "Pendulum-v1", "kwargs": {}, "observation": "states", "distractors": "none"}


def make_torch_model(rank: int = 1) -> KoopmanModel:
    """N = 3, M = 2, P = 3."""
    torch.manual_seed(4)
    return KoopmanModel(3, 2, ModelConfig(3, 0.05, (8, 7), (6,), cost_rank=rank))


@pytest.fixture
def torch_model() -> KoopmanModel:
    return make_torch_model(2)


@pytest.fixture
def stored(torch_model) -> StoredController:
    limits = np.array([-1.0, -2.0]), np.array([1.0, 2.0])
    training = {"seed": 3, "episodes": 400, "package": "deepkoco 0.1.0"}
    return StoredController(export_model(torch_model), PlannerConfig(5), *limits, TASK, training)


@pytest.fixture
def folder(stored, tmp_path) -> Path:
    write_controller(stored, tmp_path / "run" / "model")
    return tmp_path / "run" / "model"
