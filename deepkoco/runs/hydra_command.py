"""Runs a Hydra command so that bad input ends with one line and exit status 2."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from deepkoco.agent.buffer import ReplayError
from deepkoco.agent.checkpoint import CheckpointError
from deepkoco.agent.collection import SpaceError
from deepkoco.agent.config import TrainingConfigError
from deepkoco.koopman.files.model_folder import ModelFolderError
from deepkoco.output.whole_file import WriteError
from deepkoco.planning import PlannerConfigError, UnknownSolverError
from deepkoco.runs.agents import check_installed, register
from deepkoco.runs.configs import CONFIGS
from deepkoco.runs.setting_names import check_names
from deepkoco.runs.settings import ExperimentError
from deepkoco.runs.sweep import Failure, SweepFailed, check_launcher

BAD_INPUT = (
    CheckpointError,
    ExperimentError,
    ModelFolderError,
    OmegaConfBaseException,
    PlannerConfigError,
    ReplayError,
    SpaceError,
    TrainingConfigError,
    UnknownSolverError,
    WriteError,
)


def _reason(error: Exception) -> str:
    """What is wrong, in one line."""
    if isinstance(error, MissingMandatoryValue) and (name := getattr(error, "full_key", None)):
        return f"{name} is not given; add {name}=VALUE"
    return " ".join(str(error).split())


def _check_form(arguments: list[str]) -> None:
    """Refuse a bare folder or word, before Hydra's parser says that it misses an EQUAL.

    Args:
        arguments: Of the command, without its name.

    Raises:
        ExperimentError: An argument is neither NAME=VALUE nor an option of Hydra or its value.
    """
    for before, argument in zip(["", *arguments], arguments, strict=False):
        if "=" not in argument and argument[:1] not in "-~" and not before.startswith("-"):
            raise ExperimentError(f"{argument}: settings are given as NAME=VALUE, such as run={argument}")


def _check_choices(arguments: list[str]) -> None:
    """Refuse a file that no group of configs/ has, before Hydra says so over twenty lines.

    Args:
        arguments: Of the command, without its name.

    Raises:
        ExperimentError: Names the group and its files, or what the chosen agent lacks.
    """
    own_folder = any(a.startswith(("--config-dir", "-cd")) for a in arguments)
    for argument in arguments:
        group, _, chosen = argument.lstrip("+").partition("=")
        # Other forms than a name or a list of names, such as glob(*), are for Hydra to read.
        if not re.fullmatch(r"\w+", group) or not re.fullmatch(r"\w+(,\w+)*", chosen):
            continue
        known = sorted(path.stem for path in (CONFIGS / group).glob("*.yaml"))
        if own_folder and group != "agent":
            continue
        for name in chosen.split(",") if known else []:
            if name not in known:
                raise ExperimentError(
                    f"{group}={name}: no such file in configs/{group}; choose from {', '.join(known)}"
                )
            if group == "agent":
                check_installed(name)


@dataclass
class _Outcome:
    """How far a command came.

    Attributes:
        started: Whether its settings could be read.
    """

    started: bool = False


@contextmanager
def _as_arguments(arguments: Sequence[str] | None) -> Iterator[list[str]]:
    """The arguments of a command, where Hydra looks for them; None leaves those of the process."""
    before = sys.argv
    sys.argv = before if arguments is None else [before[0], *arguments]
    try:
        yield sys.argv[1:]
    finally:
        sys.argv = before


def run_command(name: str, task: Callable[[Any], None], arguments: Sequence[str] | None = None) -> None:
    """Read a command's settings and run it; a sweep goes on behind a run that fails.

    Args:
        name: File in configs/, without its ending.
        task: Gets the typed settings.
        arguments: NAME=VALUE and options of Hydra; None takes those of the process.

    Raises:
        SystemExit: Status 2 after bad input, 1 after a crash in a sweep; the reason is printed.
    """
    with _as_arguments(arguments) as given:
        _run_command(name, task, given)


def exit_status(name: str, task: Callable[[Any], None], arguments: Sequence[str]) -> int:
    """`run_command` for a caller that wants the exit status: 0 done, 2 bad input, 1 a run of a sweep crashed."""
    try:
        run_command(name, task, arguments)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    return 0


def _run_command(name: str, task: Callable[[Any], None], arguments: list[str]) -> None:
    register()
    outcome = _Outcome()
    try:
        _check_form(arguments)
        _check_choices(arguments)
        check_names(name, arguments)
        check_launcher(arguments)
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    # For the processes a launcher starts; in this one the libraries have read theirs already.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

    def entry(config: DictConfig) -> Failure | None:
        outcome.started = True
        sweep = HydraConfig.get().mode == RunMode.MULTIRUN
        try:
            task(OmegaConf.to_object(config))
        except BAD_INPUT as error:
            reason = _reason(error)
            print(f"error: {reason}", file=sys.stderr, flush=True)
            if not sweep:
                sys.exit(2)
            return Failure(reason, refused=True)
        except Exception as error:
            if not sweep:
                raise
            traceback.print_exc()
            return Failure(f"{type(error).__name__}: {' '.join(str(error).split())}")
        return None

    try:
        hydra.main(version_base="1.3", config_path=str(CONFIGS), config_name=name)(entry)()
    except SweepFailed:
        raise
    except SystemExit as stop:
        # Hydra ends with 1 when a setting is unknown or ill-typed.
        if stop.code == 1 and not outcome.started:
            sys.exit(2)
        raise
