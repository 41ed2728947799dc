from .deepkoopman import (
    DeepKoopmanModel as DeepKoopmanModel,
    read_deepkoopman as read_deepkoopman,
)
from .loaded_model import (
    LoadedModel as LoadedModel,
    Prediction as Prediction,
    load as load,
)
from .pykoopman import (
    from_matrices as from_matrices,
    from_pykoopman as from_pykoopman,
)
