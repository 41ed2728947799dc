from .interchange.loaded_model import (
    LoadedModel as LoadedModel,
    load as load,
)

__version__: str
