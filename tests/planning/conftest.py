"""Random planning problems."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco.koopman import ExportedModel, KoopmanModel, ModelConfig, export_model
from deepkoco.koopman.latent_model import DenseTransition


def make_random_model(
    seed: int, pairs: int = 3, actions: int = 1, rank: int = 1, decoder: tuple[int, ...] = ()
) -> ExportedModel:
    """A latent model with random weights whose growth rates lie around zero."""
    torch.manual_seed(seed)
    config = ModelConfig(pairs, 0.05, (8,), (8,), cost_rank=rank, decoder_hidden=decoder)
    model = KoopmanModel(3, actions, config)
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


def draw_dynamics(model: ExportedModel, seed: int, kind: str):
    """The model's own Jordan blocks, or a random dense matrix of the same size near the unit circle."""
    if kind == "jordan":
        return model.dynamics
    size = model.dynamics.latent_size
    rng = np.random.default_rng(seed)
    return DenseTransition(np.eye(size) + rng.normal(size=(size, size)) * 0.3 / size**0.5)


def make_steady_model(seed: int, actions: int = 1) -> ExportedModel:
    """A model whose psi gives the same C at every latent, and whose phi is affine: frozen is exact."""
    model = make_random_model(seed, actions=actions, decoder=(6,))
    weight, bias = model.cost_factor[-1]
    rng = np.random.default_rng(seed)
    cost_factor = (*model.cost_factor[:-1], (0.0 * weight, rng.normal(size=bias.shape)))
    size = model.dynamics.latent_size
    encoder = ((rng.normal(size=(size, 3 + actions)), rng.normal(size=size)),)
    return replace(model, cost_factor=cost_factor, encoder=encoder)


@pytest.fixture(scope="session")
def random_model():
    """Makes a model from (seed, pairs, actions, rank, decoder)."""
    return make_random_model


@pytest.fixture(scope="session")
def steady_model():
    """Makes a model with constant B and C from (seed, actions)."""
    return make_steady_model


@pytest.fixture(scope="session")
def random_state():
    """Draws rows, cost row and action from (model, seed)."""
    return draw_random_state


@pytest.fixture(scope="session")
def random_dynamics():
    """Draws dynamics from (model, seed, "jordan" or "dense")."""
    return draw_dynamics


@pytest.fixture
def model() -> ExportedModel:
    return make_random_model(0)
