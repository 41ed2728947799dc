"""A small latent model with random weights."""

import pytest
import torch

from deepkoco.koopman import ExportedModel, KoopmanModel, ModelConfig, export_model


@pytest.fixture
def model() -> ExportedModel:
    """N = 3, M = 1, P = 2."""
    torch.manual_seed(2)
    return export_model(KoopmanModel(3, 1, ModelConfig(2, 0.05, (8,), (8,))))
