"""Logs and systems that a command line names."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from deepkoco.cli.input_error import InputError

if TYPE_CHECKING:
    from deepkoco.logs.recording import Recording
    from deepkoco.systems import System

OWN_SYSTEM = "my_robot.py:CLASS, arm.xml, arm.urdf or model.yaml"
SYSTEM_HELP = "system: a name, my_robot.py:CLASS, package.module:CLASS, arm.xml, arm.urdf or model.yaml"


def read_logs(
    args: argparse.Namespace, paths: Sequence[Path], system: System | None
) -> tuple[System, list[Recording]]:
    """Read logs of one system. Without ``system``, the arguments or the first log name it.

    Raises:
        InputError: The system is unknown, or neither names it.
        LogError: A log cannot be read.
    """
    from deepkoco.logs.recording import read_log
    from deepkoco.systems import UnknownSystemError, load_system, system_names

    name = args.system
    if system is None and name is not None:
        system = named_system(name)
    recordings = []
    for path in paths:
        if system is None:
            said = read_log(path, args.map, fill=args.fill).system
            if said is None:
                raise InputError(
                    f"{path}: the sidecar does not name the system; give --system: {OWN_SYSTEM}, or one of "
                    f"{', '.join(system_names())}"
                )
            try:
                system = load_system(said, (path.parent, Path()))
            except UnknownSystemError as error:
                raise InputError(
                    f"{path}: the system of the sidecar: {error}; give --system for one of your own: {OWN_SYSTEM}"
                ) from error
        channels = [(c.name, c.unit, c.kind) for c in (*system.commands, *system.measurements)]
        recordings.append(read_log(path, args.map, system.name, channels=channels, fill=args.fill))
    assert system is not None or not paths
    return system, recordings  # type: ignore[return-value]


def named_system(name: str) -> System:
    """Make the system that `--system` names: see `deepkoco.load_system`.

    Raises:
        InputError: There is no such system, or its file cannot be read.
    """
    from deepkoco.systems import ModelFileError, UnknownSystemError, load_system

    try:
        return load_system(name)
    except (ModelFileError, UnknownSystemError) as error:
        raise InputError(f"--system: {error}") from error
