"""Models to and from elsewhere: load from a folder or a hub, import from others, export for others."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepkoco.interchange.deepkoopman import DeepKoopmanModel, read_deepkoopman
    from deepkoco.interchange.loaded_model import LoadedModel, Prediction, load
    from deepkoco.interchange.pykoopman import from_matrices, from_pykoopman

_HOMES = {
    "DeepKoopmanModel": "deepkoco.interchange.deepkoopman",
    "LoadedModel": "deepkoco.interchange.loaded_model",
    "Prediction": "deepkoco.interchange.loaded_model",
    "from_matrices": "deepkoco.interchange.pykoopman",
    "from_pykoopman": "deepkoco.interchange.pykoopman",
    "load": "deepkoco.interchange.loaded_model",
    "read_deepkoopman": "deepkoco.interchange.deepkoopman",
}
__all__ = [
    "DeepKoopmanModel",
    "LoadedModel",
    "Prediction",
    "from_matrices",
    "from_pykoopman",
    "load",
    "read_deepkoopman",
]


def __getattr__(name: str) -> Any:
    # Names are loaded on first use so that a controller on a robot does not import torch.
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
