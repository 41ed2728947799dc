"""Tasks: where an episode starts, what the agent sees and what it pays."""

from deepkoco.envs.tasks.registry import SWING_UPS, TASKS, UnknownTaskError, find_task
from deepkoco.envs.tasks.swing_up import SwingUp
from deepkoco.envs.tasks.task import Task
from deepkoco.envs.tasks.tracking import Tracking

__all__ = ["SWING_UPS", "TASKS", "SwingUp", "Task", "Tracking", "UnknownTaskError", "find_task"]
