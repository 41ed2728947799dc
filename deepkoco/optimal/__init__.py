"""Control with the simulation's own equations: the best that any controller of a task could do."""

from deepkoco.optimal.ilqr import ILQR, squared_curvature, true_curvature
from deepkoco.optimal.mpc import ModelPredictiveControl, PredictiveConfig
from deepkoco.optimal.rollout import Episodes, play
from deepkoco.optimal.true_model import TrueModel, TrueModelError, start_states
from deepkoco.optimal.value_iteration import ValueIteration, ValueTable

__all__ = [
    "ILQR",
    "Episodes",
    "ModelPredictiveControl",
    "PredictiveConfig",
    "TrueModel",
    "TrueModelError",
    "ValueIteration",
    "ValueTable",
    "play",
    "squared_curvature",
    "start_states",
    "true_curvature",
]
