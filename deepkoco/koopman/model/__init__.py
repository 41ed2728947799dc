"""The torch model: encoder, cost, and the rollout of its latents."""

from deepkoco.koopman.model.model import KoopmanModel, ModelConfig

__all__ = ["KoopmanModel", "ModelConfig"]
