from . import diagnose as diagnose
from . import fit as fit
from .diagnose.causes import register_cause as register_cause
from .engines.robot import register_object as register_object
from .envs.making import make_env as make_env
from .envs.tasks.registry import register_task as register_task
from .envs.tasks.task import Task as Task
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
