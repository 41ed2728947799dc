"""Models to and from elsewhere: load from a folder or a hub, import from others, export for others."""

from deepkoco.old_names import names_on_demand

__getattr__, __dir__, __all__ = names_on_demand(__name__, __file__)
