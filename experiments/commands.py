"""Runs a Hydra command so that bad input ends with one line and exit status 2."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from deepkoco.agent.checkpoint import CheckpointError
from deepkoco.agent.collection import SpaceError
from deepkoco.agent.config import TrainingConfigError
from deepkoco.koopman.exported import ModelFolderError
from deepkoco.planning import PlannerConfigError, UnknownSolverError
from experiments.environments import ExperimentError
from experiments.settings import register

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
BAD_INPUT = (
    CheckpointError,
    ExperimentError,
    ModelFolderError,
    OmegaConfBaseException,
    PlannerConfigError,
    SpaceError,
    TrainingConfigError,
    UnknownSolverError,
)


@dataclass
class _Outcome:
    """How far a command came."""

    started: bool = False


def run_command(name: str, task: Callable[[Any], None]) -> None:
    """Read a command's settings and run it.

    Args:
        name: File in configs/, without its ending.
        task: Gets the typed settings.
    """
    register()
    outcome = _Outcome()

    def entry(config: DictConfig) -> None:
        outcome.started = True
        try:
            task(OmegaConf.to_object(config))
        except BAD_INPUT as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)

    try:
        hydra.main(version_base="1.3", config_path=str(CONFIGS), config_name=name)(entry)()
    except SystemExit as stop:
        # Hydra ends with 1 when a setting is unknown or ill-typed.
        if stop.code == 1 and not outcome.started:
            sys.exit(2)
        raise
