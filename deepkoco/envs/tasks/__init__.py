"""Tasks: where an episode starts, what the agent sees and what it pays."""

from deepkoco.envs.tasks.circle import CircleFollowing
from deepkoco.envs.tasks.goal import GoalTask
from deepkoco.envs.tasks.registry import (
    SWING_UPS,
    TASKS,
    UnknownTaskError,
    find_task,
    load_task,
    register_task,
)
from deepkoco.envs.tasks.swing_up import SwingUp
from deepkoco.envs.tasks.task import FixedTask, Task, TaskDeclarationError
from deepkoco.envs.tasks.tracking import Tracking

__all__ = [
    "SWING_UPS",
    "TASKS",
    "CircleFollowing",
    "FixedTask",
    "GoalTask",
    "SwingUp",
    "Task",
    "TaskDeclarationError",
    "Tracking",
    "UnknownTaskError",
    "find_task",
    "load_task",
    "register_task",
]
