"""DeepKoCo: delay-graph simulation, deep Koopman control, identification and diagnosis."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepkoco.interchange.loaded_model import LoadedModel, load

__version__ = "0.1.0"
__all__ = ["LoadedModel", "__version__", "load"]

_HOMES = {"LoadedModel": "deepkoco.interchange.loaded_model", "load": "deepkoco.interchange.loaded_model"}


def __getattr__(name: str) -> Any:
    # Loaded on first use: the command line and the simulation do without the controller.
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
