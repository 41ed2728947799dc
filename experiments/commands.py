"""Runs a Hydra command so that bad input ends with one line and exit status 2."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from deepkoco.agent.buffer import ReplayError
from deepkoco.agent.checkpoint import CheckpointError
from deepkoco.agent.collection import SpaceError
from deepkoco.agent.config import TrainingConfigError
from deepkoco.koopman.model_folder import ModelFolderError
from deepkoco.planning import PlannerConfigError, UnknownSolverError
from experiments.settings import ExperimentError, register

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
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
)


@dataclass
class _Outcome:
    """How far a command came.

    Attributes:
        started: Whether its settings could be read.
        refused: Runs of a sweep that were refused.
    """

    started: bool = False
    refused: int = 0


def run_command(name: str, task: Callable[[Any], None]) -> None:
    """Read a command's settings and run it; a sweep goes on behind a run that is refused.

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
            print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
            if HydraConfig.get().mode != RunMode.MULTIRUN:
                sys.exit(2)
            outcome.refused += 1

    try:
        hydra.main(version_base="1.3", config_path=str(CONFIGS), config_name=name)(entry)()
    except SystemExit as stop:
        # Hydra ends with 1 when a setting is unknown or ill-typed.
        if stop.code == 1 and not outcome.started:
            sys.exit(2)
        raise
    if outcome.refused:
        print(f"error: {outcome.refused} runs of the sweep were refused", file=sys.stderr)
        sys.exit(2)
