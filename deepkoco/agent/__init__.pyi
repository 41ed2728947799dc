from .config import (
    TrainingConfig as TrainingConfig,
)
from .delayed_policy import (
    DelayedPolicy as DelayedPolicy,
)
from .policy import (
    KoopmanPolicy as KoopmanPolicy,
)
from .policy import (
    load_policy as load_policy,
)
from .training import (
    Trainer as Trainer,
)
