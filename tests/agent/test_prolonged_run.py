"""A finished run that is prolonged."""

import sys
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
import torch

from deepkoco.agent import Trainer
from deepkoco.agent.checkpoint import load_checkpoint
from deepkoco.envs.task_factory import TaskConfig
from deepkoco.runs.prolong import prolong
from deepkoco.runs.settings import ExperimentError, TrainRunConfig

sys.path.insert(0, str(Path(__file__).parent))
from small_run import make_envs, small_config

CONFIG = replace(small_config(), first_epochs=2, scale=True, total_episodes=10, reference_episodes=0)


def settings(agent) -> TrainRunConfig:
    return TrainRunConfig(task=TaskConfig(name="pendulum", id="Pendulum-v1"), agent=agent, run="runs/short")


def trained(folder: Path, config) -> Path:
    folder.mkdir(exist_ok=True)
    Trainer(make_envs, config, 7, folder).run()
    return folder


@pytest.fixture(scope="module")
def long(tmp_path_factory) -> Path:
    return trained(tmp_path_factory.mktemp("runs") / "long", replace(CONFIG, total_episodes=18))


def test_it_ends_with_the_bytes_of_one_that_was_as_long_from_the_start(long, tmp_path):
    folder = trained(tmp_path / "short", CONFIG)
    longer, difference = prolong(settings(CONFIG), folder, 18, "config.yaml")
    assert difference == ""
    trained(folder, longer.agent)
    for name in ("model.safetensors", "config.json"):
        assert (folder / "model" / name).read_bytes() == (long / "model" / name).read_bytes()
    own, other = (
        pd.read_csv(f / "metrics.csv").drop(columns=["seconds", "processor_seconds"]) for f in (folder, long)
    )
    pd.testing.assert_frame_equal(own, other, check_exact=True)
    states = [load_checkpoint(f / "checkpoint.pt") for f in (folder, long)]
    torch.testing.assert_close(states[0]["optimiser"], states[1]["optimiser"], rtol=0, atol=0)


def test_what_depends_on_the_end_is_named(tmp_path):
    config = replace(CONFIG, total_episodes=11, final_learning_rate=0.5)
    folder = trained(tmp_path / "short", config)
    longer, difference = prolong(settings(config), folder, 18, "config.yaml")
    assert difference == (
        "its steps have fallen towards episode 11 already and its last iteration had 1 episodes and not 4"
    )
    assert Trainer(make_envs, longer.agent, 7, folder).run()["episodes"] == 18


def test_a_kill_while_it_is_prolonged_leaves_a_run_that_can_be(tmp_path):
    folder = trained(tmp_path / "short", CONFIG)
    before = (folder / "before_end.pt").read_bytes()
    prolong(settings(CONFIG), folder, 18, "config.yaml")
    (folder / "before_end.pt").write_bytes(before)  # as if killed before the last two steps
    (folder / "config.yaml").unlink()
    longer, difference = prolong(settings(CONFIG), folder, 18, "config.yaml")
    assert difference == ""
    assert Trainer(make_envs, longer.agent, 7, folder).run()["episodes"] == 18


def test_fewer_episodes_and_runs_that_do_not_say_how_they_were_are_refused(long):
    config = settings(replace(CONFIG, total_episodes=18))
    with pytest.raises(ExperimentError, match="has 18 episodes; give more"):
        prolong(config, long, 18, "config.yaml")
    before = (long / "before_end.pt").read_bytes()
    (long / "before_end.pt").unlink()
    with pytest.raises(ExperimentError, match=r"has no before_end\.pt"):
        prolong(config, long, 22, "config.yaml")
    (long / "before_end.pt").write_bytes(before)
