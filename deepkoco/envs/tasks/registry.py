"""Names of the tasks: a new task is an entry here, a new family of tasks one file more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from deepkoco.envs.tasks.circle import CircleFollowing
from deepkoco.envs.tasks.goal import GoalTask
from deepkoco.envs.tasks.swing_up import SwingUp
from deepkoco.envs.tasks.task import Task
from deepkoco.envs.tasks.tracking import Tracking
from deepkoco.own_objects import (
    OwnObjectError,
    entry_point,
    entry_point_names,
    find_object,
    in_words,
    names_object,
)
from deepkoco.suggestion import did_you_mean
from deepkoco.systems.bodies.quadrotor_height import FULL_THRUST

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
    "quadrotor_circle": CircleFollowing(
        "quadrotor", (FULL_THRUST, 0.5, 0.5), speed_limit=5.0, control_rate=50.0
    ),
}


ENTRY_POINTS = "deepkoco.tasks"  # group in which an installed package declares tasks


class UnknownTaskError(ValueError):
    """A name does not belong to any task, or what a user names leads to none."""


def find_task(name: str) -> Task:
    """Task of the given name.

    Raises:
        UnknownTaskError: There is no such task; the message lists those there are.
    """
    if name not in TASKS:
        known = sorted({*TASKS, *entry_point_names(ENTRY_POINTS)})
        suggestion = did_you_mean(name, known)
        raise UnknownTaskError(
            f'unknown task "{name}"{suggestion or ";"} known tasks: {", ".join(known)}; '
            "one of your own: my_task.py:CLASS"
        )
    return TASKS[name]


def register_task(task: Any, name: str | None = None) -> Any:
    """Give a task a name for this process; usable as a decorator of the class.

    Args:
        task: A `Task`, or a subclass that is made without arguments.
        name: Its name; None takes that of the class.

    Returns:
        ``task``.

    Raises:
        UnknownTaskError: It is no task, or another one has the name.
    """
    made = _made(task, repr(task))
    given = name or (task.__name__ if isinstance(task, type) else type(task).__name__)
    before = TASKS.get(given)
    if before is not None and type(before).__qualname__ != type(made).__qualname__:
        raise UnknownTaskError(f'there is a task "{given}" already; give another name')
    TASKS[given] = made
    return task


def load_task(what: Any) -> Task:
    """Make the task that a user names.

    A file of Python is imported, so its code runs: load only files that you trust.

    Args:
        what: One of

            - None: a `GoalTask`, which leads all positions to 0;
            - a mapping such as ``{"pole": 3.14}``: a `GoalTask` with this goal;
            - a name: one of `TASKS`, or an entry point of the group ``deepkoco.tasks``;
            - ``"my_task.py:Swing"`` or ``"package.module:Swing"``;
            - a `Task`, or a subclass that is made without arguments.

    Raises:
        UnknownTaskError: There is none; the message says what to change.
    """
    if what is None:
        return GoalTask()
    if isinstance(what, Mapping):
        return GoalTask({str(name): float(value) for name, value in what.items()})
    if not isinstance(what, str):
        return _made(what, repr(what))
    if what in TASKS:
        return TASKS[what]
    try:
        if names_object(what):
            return _made(find_object(what, Task).value, what)
        return _made(entry_point(ENTRY_POINTS, what), what)
    except OwnObjectError as error:
        raise UnknownTaskError(str(error)) from error
    except KeyError:
        return find_task(what)


def _made(task: Any, text: str) -> Task:
    if isinstance(task, type):
        try:
            task = task()
        except Exception as error:
            raise UnknownTaskError(f"{text} cannot be made without arguments: {in_words(error)}") from error
    if not isinstance(task, Task):
        raise UnknownTaskError(f"{text} is no Task: derive the class from deepkoco.Task")
    return task
