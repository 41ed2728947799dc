"""A stand-in for a real robot: own physics, own process, hidden effects, and how to record it."""

from deepkoco.old_names import names_on_demand

__getattr__, __dir__, __all__ = names_on_demand(__name__, __file__)
