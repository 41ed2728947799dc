from .interchange.loaded_model import (
    LoadedModel as LoadedModel,
)
from .interchange.loaded_model import (
    load as load,
)

__version__: str
