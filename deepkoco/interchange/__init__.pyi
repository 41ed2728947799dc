from .deepkoopman import (
    DeepKoopmanModel as DeepKoopmanModel,
)
from .deepkoopman import (
    read_deepkoopman as read_deepkoopman,
)
from .loaded_model import (
    LoadedModel as LoadedModel,
)
from .loaded_model import (
    Prediction as Prediction,
)
from .loaded_model import (
    load as load,
)
from .pykoopman import (
    from_matrices as from_matrices,
)
from .pykoopman import (
    from_pykoopman as from_pykoopman,
)
