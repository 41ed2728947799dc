from . import diagnose as diagnose
from . import fit as fit
from .interchange.loaded_model import (
    LoadedModel as LoadedModel,
)
from .interchange.loaded_model import (
    load as load,
)

__version__: str
