"""What an agent sees besides the task: distractors of states and of frames."""

from deepkoco.envs.distractors.options import SPLITS, DistractorError, DistractorOptions, Setup
from deepkoco.envs.distractors.state_wrapper import StateDistractors, VectorStateDistractors

__all__ = [
    "SPLITS",
    "DistractorError",
    "DistractorOptions",
    "Setup",
    "StateDistractors",
    "VectorStateDistractors",
]
