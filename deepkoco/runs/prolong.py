"""Goes on with a finished run for more episodes."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from deepkoco.agent.checkpoint import load_checkpoint, save_checkpoint
from deepkoco.agent.training import BEFORE_END_FILE, CHECKPOINT_FILE, MODEL_FOLDER
from deepkoco.output.whole_file import whole_file
from deepkoco.runs.settings import ExperimentError, TrainRunConfig


def prolong(config: TrainRunConfig, folder: Path, total: int, config_file: str) -> tuple[TrainRunConfig, str]:
    """Make a run one of more episodes, to be resumed.

    A run goes on from before what it did at its end: there it evaluated more episodes and went back to its best
    weights, which a longer run would not have done then. A kill between the steps leaves a folder on which the same
    call works again.

    Args:
        config: Settings stored with the run.
        folder: The run's folder.
        total: Episodes it shall have.
        config_file: Name of the file of the settings.

    Returns:
        The settings of the longer run, and in which way it differs from one that was as long from the start; empty
        where every byte is the same.

    Raises:
        ExperimentError: The run has as many episodes already, or it does not say how it was before its end.
        CheckpointError: A file is missing or damaged.
    """
    before, old = folder / BEFORE_END_FILE, config.agent.total_episodes
    finished = (folder / MODEL_FOLDER).is_dir()
    if total < old or (total == old and finished):
        raise ExperimentError(
            f"{folder}: agent.total_episodes = {total}, but the run has {old} episodes; give more to go on with it"
        )
    if total == old:
        return config, ""
    if finished and not before.is_file():
        raise ExperimentError(
            f"{folder}: cannot be prolonged, it has no {BEFORE_END_FILE}; runs of other agents and of earlier releases "
            f"have none: train with agent.total_episodes={total} in another folder"
        )
    agent = replace(config.agent, total_episodes=total)
    agent.check()
    longer = replace(config, agent=agent)
    state = load_checkpoint(before if before.is_file() else folder / CHECKPOINT_FILE)
    difference = _difference(config.agent, state)
    state["config"]["total_episodes"] = total
    # Without its model the run is one that was killed before its export, whatever happens from here on.
    shutil.rmtree(folder / MODEL_FOLDER, ignore_errors=True)
    save_checkpoint(folder / CHECKPOINT_FILE, state)
    with whole_file(folder / config_file) as partial:
        OmegaConf.save(OmegaConf.structured(longer), partial, resolve=True)
    before.unlink(missing_ok=True)
    return longer, difference


def _difference(agent: Any, state: dict[str, Any]) -> str:
    """Why a prolonged run is not the same as one that was as long from the start; empty where it is."""
    later = max(0, agent.total_episodes - agent.first_episodes)
    left, whole = later % agent.iteration_episodes, later // agent.iteration_episodes
    collected = state["progress"]["iteration"] + state["progress"]["collected"]
    reasons = []
    if agent.final_learning_rate != 1.0:
        reasons.append(f"its steps have fallen towards episode {agent.total_episodes} already")
    if left and collected > 1 + whole:
        reasons.append(f"its last iteration had {left} episodes and not {agent.iteration_episodes}")
    if agent.first_episodes > agent.total_episodes and collected:
        reasons.append(
            f"its first iteration had {agent.total_episodes} episodes and not {agent.first_episodes}"
        )
    return " and ".join(reasons)
