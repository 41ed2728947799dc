"""Runs of earlier releases, whose stored settings do not name what came later."""

from dataclasses import asdict
from pathlib import Path

from omegaconf import OmegaConf

from deepkoco.agent.config import OLDER_SETTINGS, TrainingConfig
from deepkoco.cli.command_line import main
from deepkoco.envs.task_factory import TaskConfig
from deepkoco.runs.settings import TrainRunConfig
from deepkoco.runs.train import load_run_config


def test_a_run_that_does_not_name_a_younger_setting_goes_on_as_it_began(tmp_path: Path):
    config = OmegaConf.structured(
        TrainRunConfig(task=TaskConfig("pendulum", "Pendulum-v1"), agent=TrainingConfig())
    )
    stored = OmegaConf.to_container(config)
    for name in OLDER_SETTINGS:
        del stored["agent"][name]
    OmegaConf.save(OmegaConf.create(stored), tmp_path / "config.yaml")
    loaded = asdict(load_run_config(tmp_path).agent)
    assert {name: loaded[name] for name in OLDER_SETTINGS} == OLDER_SETTINGS


def test_tasks_whose_results_are_recorded_learn_as_they_did(capsys):
    assert main(["train", "--cfg", "job", "task=manipulator"]) == 0
    recorded = OmegaConf.create(capsys.readouterr().out)
    assert {name: recorded.agent[name] for name in OLDER_SETTINGS} == OLDER_SETTINGS
    assert (recorded.agent.keep, recorded.agent.evaluation_episodes, recorded.agent.model.pairs) == (
        "last",
        10,
        30,
    )
    assert main(["train", "--cfg", "job", "task=gymnasium", "task.id=Pendulum-v1"]) == 0
    assert OmegaConf.create(capsys.readouterr().out).agent.scale is True
