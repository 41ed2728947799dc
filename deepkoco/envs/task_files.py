"""Files that the arguments of a task name, such as a model.yaml: found from any folder, and after they are gone."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

TASK_FILES = "task_files"
"""Folder of a run with the copies, one folder for each argument."""


def _named_files(arguments: Mapping[str, Any]) -> Iterator[tuple[str, Path]]:
    """Arguments that look like a file: a text with a file ending."""
    for name, value in arguments.items():
        if isinstance(value, str) and Path(value).suffix:
            yield name, Path(value)


def with_absolute_paths(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments, with the absolute path of every file that is there."""
    found = {name: str(path.absolute()) for name, path in _named_files(arguments) if path.is_file()}
    return {**arguments, **found}


def keep_copies(arguments: Mapping[str, Any], run: Path) -> None:
    """Copy the files into a run's folder.

    Args:
        arguments: Of the task.
        run: Folder of the run.
    """
    for name, path in _named_files(arguments):
        if path.is_file():
            copy = run / TASK_FILES / name / path.name
            copy.parent.mkdir(parents=True)
            shutil.copyfile(path, copy)


def find_files(arguments: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The arguments, with the run's own copy in the place of every file that is not there any more.

    Args:
        arguments: As stored with a run.
        folder: Of the run, or of the model in it.
    """
    found = dict(arguments)
    for name, path in _named_files(arguments):
        copies = [run / TASK_FILES / name / path.name for run in (folder, folder.absolute().parent)]
        if not path.is_file() and (copy := next(filter(Path.is_file, copies), None)):
            found[name] = str(copy.absolute())
    return found


def missing_files(arguments: Mapping[str, Any]) -> str:
    """Words on the relative paths among the arguments that lead nowhere from the current folder; "" if none does."""
    lost = [str(path) for _, path in _named_files(arguments) if not path.is_absolute() and not path.is_file()]
    if not lost:
        return ""
    where = f"is not below the current folder, {Path.cwd()}"
    return f"; {', '.join(lost)} {where}: give the absolute path, or go to its folder"
