"""Nodes, delays, timing and execution of robot simulations, and recordings of what happened."""

from deepkoco.old_names import names_on_demand

__getattr__, __dir__, __all__ = names_on_demand(__name__, __file__)
