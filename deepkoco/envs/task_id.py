"""Gymnasium ids with the module that registers them: `my_robot:Cart-v0`."""

from __future__ import annotations

import os
import sys
from importlib import import_module

import gymnasium
from gymnasium.envs.registration import EnvSpec


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
        _import(module, task_id)
    try:
        return gymnasium.spec(name)
    except gymnasium.error.Error as error:
        hint = (
            f"the module {module} is imported, but it registers no {name}"
            if separator
            else f"for an environment of your own give MODULE:{name}, and the module that registers it is imported"
        )
        raise TaskIdError(f'"{task_id}": {str(error).rstrip(".")}; {hint}') from error


def _import(module: str, task_id: str) -> None:
    here = os.getcwd()
    # As with `python my_robot.py`; an installed command has the folder of the command there instead.
    if not {"", here} & set(sys.path):
        sys.path.insert(0, here)
    try:
        import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise TaskIdError(f'"{task_id}": {module} needs a module that is missing: {error}') from error
        raise TaskIdError(
            f'"{task_id}": there is no module {error.name}, neither in {here} nor installed'
        ) from error
    except Exception as error:
        reason = " ".join(str(error).split())
        raise TaskIdError(
            f'"{task_id}": importing {module} failed: {type(error).__name__}: {reason}'
        ) from error
