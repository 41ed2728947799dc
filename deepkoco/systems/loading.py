"""Find a system by what a user gives: a name, his class, an MJCF or URDF file, or a model.yaml."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from deepkoco.own_objects import origin_of_class
from deepkoco.systems.model_yaml import load_model
from deepkoco.systems.origins import SystemLoadError, find_system, made
from deepkoco.systems.system import System

MODEL_FILES = (".yaml", ".yml")


def load_system(what: str | Path | System | type[System], folders: Sequence[Path] = (Path(),)) -> System:
    """Make the system that a user names.

    A file of Python is imported, so its code runs: load only files that you trust. The same holds for a model.yaml,
    whose key ``origin`` can name such a file.

    Args:
        what: One of

            - a name: ``"rod_pendulum"``, a registered one, or an entry point of the group ``deepkoco.systems``;
            - a class: ``"my_robot.py:CartPole"``, or ``"package.module:CartPole"``; the class may be left out where
              the file defines one system;
            - an MJCF or URDF file: ``"arm.xml"``, ``"arm.urdf"``;
            - a ``model.yaml`` that the package has written;
            - a `System`, which is returned as it is, or a subclass of it.
        folders: Where relative paths are looked for, in this order.

    Returns:
        The system with its nominal parameters. Its ``origin`` is the text that finds it again, None for a system of
        the package.

    Raises:
        SystemLoadError: A file, a class or a module cannot be found or imported.
        UnknownSystemError: There is no system of that name.
        ModelFileError: A model.yaml cannot be read.
    """
    if isinstance(what, System):
        return what
    if isinstance(what, type):
        if not issubclass(what, System):
            raise SystemLoadError(f"{what.__name__} is no System: derive the class from deepkoco.System")
        return made(what, what.__name__, origin_of_class(what))
    text = str(what)
    if Path(text).suffix.lower() not in MODEL_FILES:
        return find_system(text, folders)
    there = [path for folder in folders if (path := folder / text).is_file()]
    return load_model(there[0] if there else text)


def any_system(system: str | Path | System | type[System]) -> System:
    """The system itself, or the one that `load_system` finds."""
    return load_system(system)
