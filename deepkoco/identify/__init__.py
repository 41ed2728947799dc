"""Parameters and states of a system from recorded logs."""

from deepkoco.identify.fit import Fit, FitProblem, Trial
from deepkoco.identify.identifiability import Direction, unidentified
from deepkoco.identify.noise import Noise, estimate_noise
from deepkoco.identify.prior import Prior
from deepkoco.identify.windows import Windows, cut_windows, moving, window_length

__all__ = [
    "Direction",
    "Fit",
    "FitProblem",
    "Noise",
    "Prior",
    "Trial",
    "Windows",
    "cut_windows",
    "estimate_noise",
    "moving",
    "unidentified",
    "window_length",
]
