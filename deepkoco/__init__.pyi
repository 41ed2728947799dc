from . import diagnose as diagnose
from . import fit as fit
from .interchange.loaded_model import (
    LoadedModel as LoadedModel,
)
from .interchange.loaded_model import (
    load as load,
)
from .systems.loading import load_system as load_system
from .systems.registry import register_system as register_system
from .systems.system import Channel as Channel
from .systems.system import Parameter as Parameter
from .systems.system import System as System

__version__: str
