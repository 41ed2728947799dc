"""What a fitted model leaves unexplained, and how it is described."""

from deepkoco.diagnose.residuals.residuals import MissingTorque, coloured_from, missing_torque, white_limit
from deepkoco.old_names import moved_names

__all__ = ["MissingTorque", "coloured_from", "missing_torque", "white_limit"]

__getattr__ = moved_names(__name__)
