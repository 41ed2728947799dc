"""The cost-predictive Koopman latent model. `ExportedModel` needs NumPy only, the rest needs torch."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepkoco.koopman.export import export_model
    from deepkoco.koopman.exported import ExportedModel
    from deepkoco.koopman.losses import chunk_losses
    from deepkoco.koopman.model.model import KoopmanModel, ModelConfig

_HOMES = {
    "ExportedModel": "deepkoco.koopman.exported",
    "KoopmanModel": "deepkoco.koopman.model.model",
    "ModelConfig": "deepkoco.koopman.model.model",
    "chunk_losses": "deepkoco.koopman.losses",
    "export_model": "deepkoco.koopman.export",
}
__all__ = ["ExportedModel", "KoopmanModel", "ModelConfig", "chunk_losses", "export_model"]


def __getattr__(name: str) -> Any:
    # Names are loaded on first use so that a controller on a robot does not import torch.
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
