"""Estimate parameters, delays and states of a system from recorded logs."""

from deepkoco.callable_package import make_callable
from deepkoco.fit.data.noise import Noise, estimate_noise
from deepkoco.fit.data.windows import Windows, cut_windows, moving, window_length
from deepkoco.fit.delays.hidden_delay import HiddenDelays, hidden_delays
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.graph_fit import GraphFit, GraphMisfit, fit_graph, fit_replay, seen_by_supervisor
from deepkoco.fit.identification import Convergence, Estimate, Identification
from deepkoco.fit.identify import fit
from deepkoco.fit.request import FitError
from deepkoco.fit.solve.cma import MissingExtraError, Search, cma_es
from deepkoco.fit.solve.identifiability import Direction, unidentified
from deepkoco.fit.solve.methods import METHODS, CmaEs, LevenbergMarquardt
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.state.estimator import DelayedEstimator, Memory, system_derivative, system_measurement
from deepkoco.fit.state.estimator_node import StateEstimator
from deepkoco.fit.state.unscented import Belief, FilterError, SigmaPoints

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
    "StateEstimator",
    "Trial",
    "Windows",
    "cma_es",
    "cut_windows",
    "estimate_noise",
    "fit",
    "fit_graph",
    "fit_replay",
    "hidden_delays",
    "moving",
    "seen_by_supervisor",
    "system_derivative",
    "system_measurement",
    "unidentified",
    "window_length",
]

make_callable(__name__)
