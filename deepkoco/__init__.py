"""DeepKoCo: delay-graph simulation, deep Koopman control, identification and diagnosis."""

from deepkoco.old_names import MOVED, find_moved, names_on_demand

__version__ = "0.1.0"

find_moved(MOVED)
__getattr__, __dir__, __all__ = names_on_demand(__name__, __file__)
