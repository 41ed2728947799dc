"""Systems outside of the package: found by the text that names their class or file, and that text by the system."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from deepkoco.own_objects import (
    OwnObjectError,
    find_file,
    find_object,
    in_words,
    names_object,
    origin_of_class,
    split_reference,
)
from deepkoco.systems.registry import SYSTEMS, UnknownSystemError, make_system
from deepkoco.systems.system import System

TREE_FILES = (".xml", ".mjcf", ".urdf")
FORMS = "a name, my_robot.py:CartPole, package.module:CartPole, arm.xml, arm.urdf or model.yaml"


class SystemLoadError(UnknownSystemError):
    """What a user names leads to no system; the message says what to change."""


def find_system(text: str, folders: Sequence[Path] = (Path(),)) -> System:
    """Make the system that a name, a class or an MJCF or URDF file stands for; see `load_system`."""
    if text in SYSTEMS:
        return make_system(text)
    suffix = Path(text).suffix.lower()
    try:
        if suffix in TREE_FILES:
            return _tree(find_file(text, text, folders))
        if names_object(text):
            found = find_object(text, System, folders)
            if isinstance(found.value, type):
                return made(found.value, text, found.origin)
            found.value.origin = found.origin
            return found.value
    except OwnObjectError as error:
        raise SystemLoadError(str(error)) from error
    if suffix or "/" in text or "\\" in text or split_reference(text)[1]:
        raise SystemLoadError(f'"{text}" is no system; give {FORMS}')
    return make_system(text)


def made(kind: type[System], text: str, origin: str | None) -> System:
    """An instance of a user's class, which is made without arguments.

    Raises:
        SystemLoadError: It cannot be made.
    """
    try:
        system = kind()
    except ValueError as error:
        raise SystemLoadError(f"{text}: {error}") from error
    except Exception as error:
        raise SystemLoadError(
            f"{text}: {kind.__name__}() failed: {in_words(error)}; a system is made without arguments"
        ) from error
    system.origin = origin
    return system


def origin_of(system: System) -> str | None:
    """The text by which `load_system` finds a system again; None for a name of the package, or where there is none.

    A class that was made in a notebook or in a function has no such text: register it before its model.yaml is read.
    """
    if system.origin is not None:
        return system.origin
    kind = type(system)
    return None if kind.__module__.startswith("deepkoco.") else origin_of_class(kind)


def file_of(origin: str) -> Path | None:
    """The file that an origin names; None for a module or a name."""
    place, _ = split_reference(origin)
    return Path(place) if place.endswith(".py") or Path(place).suffix.lower() in TREE_FILES else None


def stored_origin(origin: str, folder: Path) -> str:
    """An origin as a file in ``folder`` stores it: with the path from there, so that both can move together."""
    file = file_of(origin)
    if file is None:
        return origin
    here, there = Path(os.path.abspath(folder)), Path(os.path.abspath(file))
    if here.anchor != there.anchor or os.path.commonpath((here, there)) == here.anchor:
        return origin  # far from each other: the path between them says less than the whole one
    return Path(os.path.relpath(there, here)).as_posix() + origin[len(str(file)) :]


def find_stored(origin: str, folder: Path) -> System:
    """The system of an origin that a file in ``folder`` stores: looked for from there, then from the current folder.

    Raises:
        SystemLoadError: It is in neither place.
    """
    file = file_of(origin)
    if file is not None and not any((place / file).is_file() for place in (folder, Path())):
        # A copy beside the file serves as well.
        beside = f"{file.name}{origin[len(str(file)) :]}"
        if any((place / file.name).is_file() for place in (folder, Path())):
            return find_system(beside, (folder, Path()))
    return find_system(origin, (folder, Path()))


def _tree(path: Path) -> System:
    # MuJoCo reads the file: it is imported for those who have one.
    from deepkoco.systems.trees import TreeError
    from deepkoco.systems.trees.following import robot_from_file

    try:
        system = robot_from_file(path)
    except TreeError as error:
        raise SystemLoadError(str(error)) from error
    system.origin = str(path)
    return system
