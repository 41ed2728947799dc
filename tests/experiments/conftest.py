"""Run folders as training leaves them, with random weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.koopman.files.model_folder import write_model_folder
from deepkoco.planning import PlannerConfig
from deepkoco.runs.settings import TaskConfig, TrainRunConfig

MakeRun = Callable[..., Path]
METRICS = (
    "episodes,updates,seconds,train/cost,loss/linear,loss/cost_prediction,"
    "evaluation/cost,evaluation/cost_sd,evaluation/cost_median,evaluation/episodes"
)

SMALL = [
    "task=gymnasium_pendulum",
    "+task.kwargs.max_episode_steps=45",
    "agent.model.encoder_hidden=[8]",
    "agent.model.cost_hidden=[8]",
    "agent.first_episodes=4",
    "agent.first_epochs=2",
    "agent.iteration_episodes=2",
    "agent.total_episodes=7",
    "agent.evaluation_episodes=2",
    "agent.final_evaluation_episodes=3",
]


def write_run(
    folder: Path,
    task: TaskConfig | None = None,
    distractors: str = "none",
    seed: int = 0,
    entries: int = 3,
    limit: float = 2.0,
    finished: bool = True,
    cost: float = 150.0,
    observation: str = "states",
    **agent: object,
) -> Path:
    """Write config.yaml, metrics.csv and a small exported model of the rod pendulum."""
    if task is None:
        task = TaskConfig("pendulum", "deepkoco/RodPendulum-v0", kwargs={"action_units": "physical"})
    config = TrainRunConfig(
        task, seed=seed, observation=observation, distractors=distractors, run=str(folder)
    )
    for name, value in agent.items():
        setattr(config.agent, name, value)
    folder.mkdir(parents=True)
    OmegaConf.save(OmegaConf.structured(config), folder / "config.yaml", resolve=True)
    rows = [f"{n},{10 * n},{n}.5,{cost + 400 / n},0.1,0.2,{cost + 300 / n},20.0,{cost},10" for n in (90, 110)]
    (folder / "metrics.csv").write_text("\n".join([METRICS, *rows]) + "\n")
    if finished:
        torch.manual_seed(seed)
        model = export_model(KoopmanModel(entries, 1, ModelConfig(2, 0.05, (8,), (8,))))
        limits = {"action_low": [-limit], "action_high": [limit]}
        write_model_folder(
            model, folder / "model", {"planner": asdict(PlannerConfig(5)), **limits, "seed": seed}
        )
    return folder


@pytest.fixture(scope="session")
def make_run() -> MakeRun:
    """Writes a run folder; see `write_run`."""
    return write_run


@pytest.fixture(scope="session")
def small() -> list[str]:
    """Arguments of a training that takes a second."""
    return SMALL
