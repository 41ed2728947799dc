"""Files that the arguments of a task name, such as a model.yaml: found from any folder, and after they are gone."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from deepkoco.own_objects import split_reference
from deepkoco.systems.origins import file_of
from deepkoco.yaml_file import YamlFileError, read_yaml

TASK_FILES = "task_files"
"""Folder of a run with the copies, one folder for each argument."""


class _NamedFile(NamedTuple):
    """A file that an argument names, and what stands behind it: the class of ``my_robot.py:CartPole``."""

    argument: str
    path: Path
    behind: str


def _named_files(arguments: Mapping[str, Any]) -> Iterator[_NamedFile]:
    """Arguments that look like a file: a text with a file ending, or FILE.py:NAME."""
    for argument, value in arguments.items():
        if not isinstance(value, str):
            continue
        place, name = split_reference(value)
        if place.endswith(".py") and name:
            yield _NamedFile(argument, Path(place), f":{name}")
        elif Path(value).suffix:
            yield _NamedFile(argument, Path(value), "")


def with_absolute_paths(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments, with the absolute path of every file that is there."""
    found = {n: f"{path.absolute()}{behind}" for n, path, behind in _named_files(arguments) if path.is_file()}
    return {**arguments, **found}


def keep_copies(arguments: Mapping[str, Any], run: Path) -> None:
    """Copy the files into a run's folder; of a model.yaml also the file of its system.

    Args:
        arguments: Of the task.
        run: Folder of the run.
    """
    for name, path, _ in _named_files(arguments):
        if path.is_file():
            folder = run / TASK_FILES / name
            folder.mkdir(parents=True)
            shutil.copyfile(path, folder / path.name)
            origin = _file_of_system(path)
            if origin is not None:
                shutil.copyfile(origin, folder / origin.name)


def _file_of_system(model: Path) -> Path | None:
    """The file that a model.yaml takes its system from; None where there is none."""
    if model.suffix.lower() not in (".yaml", ".yml"):
        return None
    try:
        document = read_yaml(model)
    except YamlFileError:
        return None
    origin = document.get("origin") if isinstance(document, dict) else None
    named = file_of(origin) if isinstance(origin, str) else None
    if named is None:
        return None
    return next((path for folder in (model.parent, Path()) if (path := folder / named).is_file()), None)


def find_files(arguments: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The arguments, with the run's own copy in the place of every file that is not there any more.

    Args:
        arguments: As stored with a run.
        folder: Of the run, or of the model in it.
    """
    found = dict(arguments)
    for name, path, behind in _named_files(arguments):
        copies = [run / TASK_FILES / name / path.name for run in (folder, folder.absolute().parent)]
        if not path.is_file() and (copy := next(filter(Path.is_file, copies), None)):
            found[name] = f"{copy.absolute()}{behind}"
    return found


def missing_files(arguments: Mapping[str, Any]) -> str:
    """Words on the relative paths among the arguments that lead nowhere from the current folder; "" if none does."""
    named = [file.path for file in _named_files(arguments)]
    lost = [str(path) for path in named if not path.is_absolute() and not path.is_file()]
    if not lost:
        return ""
    where = f"is not below the current folder, {Path.cwd()}"
    return f"; {', '.join(lost)} {where}: give the absolute path, or go to its folder"
