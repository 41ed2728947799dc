from .export import (
    export_model as export_model,
)
from .exported import (
    ExportedModel as ExportedModel,
)
from .losses import (
    chunk_losses as chunk_losses,
)
from .model.model import (
    KoopmanModel as KoopmanModel,
)
from .model.model import (
    ModelConfig as ModelConfig,
)
