"""The cost-predictive Koopman latent model. `ExportedModel` needs NumPy only, the rest needs torch."""

from deepkoco.old_names import names_on_demand

__getattr__, __dir__, __all__ = names_on_demand(__name__, __file__)
