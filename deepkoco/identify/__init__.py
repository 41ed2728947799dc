"""Parameters, delays and states of a system from recorded logs."""

from deepkoco.identify.estimator import DelayedEstimator, Memory, system_derivative
from deepkoco.identify.fit import FitProblem
from deepkoco.identify.graph_fit import GraphFit, GraphMisfit, fit_graph, seen_by_supervisor
from deepkoco.identify.hidden_delay import HiddenDelays, hidden_delays
from deepkoco.identify.identifiability import Direction, unidentified
from deepkoco.identify.identification import Convergence, Estimate, Identification
from deepkoco.identify.identify import fit
from deepkoco.identify.methods import METHODS, CmaEs, LevenbergMarquardt
from deepkoco.identify.noise import Noise, estimate_noise
from deepkoco.identify.prior import Prior
from deepkoco.identify.question import FitError
from deepkoco.identify.search import MissingExtraError, Search, cma_es
from deepkoco.identify.trial import Fit, Trial
from deepkoco.identify.unscented import Belief, FilterError, SigmaPoints
from deepkoco.identify.windows import Windows, cut_windows, moving, window_length

__all__ = [
    "METHODS",
    "Belief",
    "CmaEs",
    "Convergence",
    "DelayedEstimator",
    "Direction",
    "Estimate",
    "FilterError",
    "Fit",
    "FitError",
    "FitProblem",
    "GraphFit",
    "GraphMisfit",
    "HiddenDelays",
    "Identification",
    "LevenbergMarquardt",
    "Memory",
    "MissingExtraError",
    "Noise",
    "Prior",
    "Search",
    "SigmaPoints",
    "Trial",
    "Windows",
    "cma_es",
    "cut_windows",
    "estimate_noise",
    "fit",
    "fit_graph",
    "hidden_delays",
    "moving",
    "seen_by_supervisor",
    "system_derivative",
    "unidentified",
    "window_length",
]
