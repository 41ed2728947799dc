"""DeepKoCo, the agent: acting, exploring, training. `load_policy` needs NumPy only, `Trainer` needs torch."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepkoco.agent.config import TrainingConfig
    from deepkoco.agent.policy import KoopmanPolicy, load_policy
    from deepkoco.agent.training import Trainer

_HOMES = {
    "KoopmanPolicy": "deepkoco.agent.policy",
    "Trainer": "deepkoco.agent.training",
    "TrainingConfig": "deepkoco.agent.config",
    "load_policy": "deepkoco.agent.policy",
}
__all__ = ["KoopmanPolicy", "Trainer", "TrainingConfig", "load_policy"]


def __getattr__(name: str) -> Any:
    # Names are loaded on first use so that a controller on a robot does not import torch.
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
