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


def read_logs(
    args: argparse.Namespace, paths: Sequence[Path], system: System | None
) -> tuple[System, list[Recording]]:
    """Read logs of one system. Without ``system``, the arguments or the first log name it.

    Raises:
        InputError: The system is unknown, or neither names it.
        LogError: A log cannot be read.
    """
    from deepkoco.logs.recording import read_log
    from deepkoco.systems import SYSTEMS

    name = args.system
    if system is None and name is not None:
        system = named_system(name)
    recordings = []
    for path in paths:
        if system is None:
            said = read_log(path, args.map, systems=tuple(SYSTEMS), fill=args.fill).system
            if said is None:
                raise InputError(
                    f"{path}: the sidecar does not name the system; give --system, one of {', '.join(SYSTEMS)}"
                )
            system = named_system(said)
        channels = [(c.name, c.unit, c.kind) for c in (*system.commands, *system.measurements)]
        recordings.append(
            read_log(path, args.map, system.name, channels=channels, systems=tuple(SYSTEMS), fill=args.fill)
        )
    assert system is not None or not paths
    return system, recordings  # type: ignore[return-value]


def named_system(name: str) -> System:
    """Make the system with this name, or load a model.yaml.

    Raises:
        InputError: The name is unknown, or the file cannot be read.
    """
    from deepkoco.systems import ModelFileError, UnknownSystemError, load_model, make_system

    try:
        return load_model(name) if name.endswith((".yaml", ".yml")) else make_system(name)
    except (ModelFileError, UnknownSystemError) as error:
        raise InputError(f"--system: {error}") from error
