"""Gymnasium ids with the module that registers them: `my_robot:Cart-v0`."""

from __future__ import annotations

import gymnasium
from gymnasium.envs.registration import EnvSpec

from deepkoco.own_objects import OwnObjectError, import_named


class TaskIdError(ValueError):
    """An id is not registered, or the module that should register it cannot be imported."""


def find_spec(task_id: str) -> EnvSpec:
    """What is registered under an id; the module before a colon is imported first.

    Args:
        task_id: "Cart-v0", or "my_robot:Cart-v0": the module is looked for in the current folder too.

    Returns:
        The specification.

    Raises:
        TaskIdError: See the class.
    """
    module, separator, name = task_id.rpartition(":")
    if separator:
        try:
            import_named(module, task_id)
        except OwnObjectError as error:
            raise TaskIdError(str(error)) from error
    try:
        return gymnasium.spec(name)
    except gymnasium.error.Error as error:
        hint = (
            f"the module {module} is imported, but it registers no {name}"
            if separator
            else f"for an environment of your own give MODULE:{name}, and the module that registers it is imported"
        )
        raise TaskIdError(f'"{task_id}": {str(error).rstrip(".")}; {hint}') from error
