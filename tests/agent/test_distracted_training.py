"""Runs among distractors are resumed like all others, and evaluated among distractors that training did not show."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from gymnasium.vector import VectorEnv
from small_image_run import image_config
from small_run import small_config

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.agent import Trainer
from deepkoco.agent.config import TrainingConfig
from deepkoco.envs.task_factory import TaskConfig, make_task_factory

KINDS = [("states", "copies+noise+projection"), ("images", "background+copies+colour+camera+sensor_noise")]


class Stopped(Exception):
    """The run was stopped."""


def factories(observation: str, name: str) -> list[Callable[[int, int], VectorEnv]]:
    kwargs = {"action_units": "physical", "max_episode_steps": 45 if observation == "states" else 24}
    task = TaskConfig("pendulum", "deepkoco/RodPendulum-v0", kwargs=kwargs)
    return [make_task_factory(task, name, observation, split=split) for split in ("train", "evaluation")]


def config(observation: str) -> TrainingConfig:
    chosen = small_config() if observation == "states" else image_config()
    sizes = {"first_epochs": 5, "iteration_updates": 20, "iteration_epochs": 10, "total_episodes": 10}
    return dataclasses.replace(chosen, **sizes)


def stop(standing) -> None:
    if standing.text.startswith("iteration 2"):
        raise Stopped


def run(folder: Path, observation: str, name: str, same_split: bool = False, stopped: bool = False):
    """Metrics of a run, all but the seconds; if stopped, of one that was stopped and resumed."""
    folder.mkdir()
    if stopped:
        train, evaluation = factories(observation, name)
        with pytest.raises(Stopped):
            Trainer(train, config(observation), 7, folder, evaluation).run(stop)
    train, evaluation = factories(observation, name)
    Trainer(train, config(observation), 7, folder, train if same_split else evaluation).run()
    return pd.read_csv(folder / "metrics.csv").drop(columns=["seconds", "processor_seconds"])


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> pd.DataFrame:
    """Metrics of an uninterrupted run on states."""
    return run(tmp_path_factory.mktemp("distracted") / "whole", *KINDS[0])


@pytest.mark.study
def test_a_resumed_run_on_states_is_the_uninterrupted_one(whole, tmp_path):
    resumed = run(tmp_path / "stopped", *KINDS[0], stopped=True)
    pd.testing.assert_frame_equal(whole, resumed, check_exact=True)


def test_a_resumed_run_on_frames_is_the_uninterrupted_one(tmp_path):
    frames = [run(tmp_path / str(stopped), *KINDS[1], stopped=stopped) for stopped in (False, True)]
    pd.testing.assert_frame_equal(*frames, check_exact=True)


def test_the_split_of_the_evaluation_changes_nothing_that_is_learned(whole, tmp_path):
    same = run(tmp_path / "same_split", *KINDS[0], same_split=True)
    changed = {column for column in whole if not whole[column].equals(same[column])}
    learned = {column for column in whole if column.startswith(("train/", "loss/", "model/"))}
    assert "evaluation/cost" in changed
    assert len(learned) > 8
    assert not changed & learned
