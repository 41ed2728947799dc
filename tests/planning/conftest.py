"""Random planning problems."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from deepkoco.koopman import ExportedModel, KoopmanModel, ModelConfig, export_model


def make_random_model(seed: int, pairs: int = 3, actions: int = 1) -> ExportedModel:
    """A latent model with random weights whose growth rates lie around zero."""
    torch.manual_seed(seed)
    model = KoopmanModel(3, actions, ModelConfig(pairs, 0.05, (8,), (8,)))
    with torch.no_grad():
        model.dynamics.mu.copy_(torch.randn(pairs))
    return export_model(model)


def draw_random_state(model: ExportedModel, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Linearisation and action at a random point; B is large enough to bring limits into play."""
    rng = np.random.default_rng(seed)
    action = rng.uniform(-1.0, 1.0, model.action_size)
    rows, factor = model.linearise(rng.normal(size=3), action)
    rows[1:] *= rng.uniform(1.0, 30.0)
    rows[0] -= rows[0].mean()
    return rows, factor, action


@pytest.fixture(scope="session")
def random_model():
    """Makes a model from (seed, pairs, actions)."""
    return make_random_model


@pytest.fixture(scope="session")
def random_state():
    """Draws rows, cost row and action from (model, seed)."""
    return draw_random_state


@pytest.fixture
def model() -> ExportedModel:
    return make_random_model(0)
