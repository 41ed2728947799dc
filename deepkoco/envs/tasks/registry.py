"""Names of the tasks: a new task is an entry here, a new family of tasks one file more."""

from __future__ import annotations

from dataclasses import replace

from deepkoco.envs.tasks.swing_up import SwingUp
from deepkoco.envs.tasks.task import Task
from deepkoco.envs.tasks.tracking import Tracking

SWING_UPS: dict[str, SwingUp] = {
    task.system: task
    for task in (
        SwingUp("rod_pendulum", (2.0,), speed_limit=8.0, control_rate=20.0, speed_weight=0.1, command_weight=0.001),
        SwingUp("pendulum", (2.0,), speed_limit=25.0, control_rate=50.0, speed_weight=0.01, command_weight=0.01),
        SwingUp("torque_pendulum", (1.5,), speed_limit=12.0, control_rate=50.0, speed_weight=0.1, command_weight=0.01),
    )
}  # fmt: skip

MANIPULATOR = Tracking("two_link_arm", (6.0, 3.0), speed_limit=15.0, control_rate=20.0, command_weight=0.001)

TASKS: dict[str, Task] = {
    **SWING_UPS,
    "manipulator": MANIPULATOR,
    "manipulator_fixed": replace(MANIPULATOR, rate=0.0),
}


class UnknownTaskError(ValueError):
    """A name does not belong to any task."""


def find_task(name: str) -> Task:
    """Task of the given name.

    Raises:
        UnknownTaskError: There is no such task; the message lists those there are.
    """
    if name not in TASKS:
        raise UnknownTaskError(f'unknown task "{name}"; known tasks: {", ".join(sorted(TASKS))}')
    return TASKS[name]
