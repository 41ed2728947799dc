"""The comparison at the end of a training: what is measured, its files, and a kill before it is written."""

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepkoco.agent import Trainer
from deepkoco.agent.checkpoint import CheckpointError
from deepkoco.agent.config import TrainingConfig, TrainingConfigError
from deepkoco.agent.references import run_comparison
from deepkoco.agent.references.comparison import EDMDC, RANDOM, ZERO
from deepkoco.agent.references.files import read_comparison

sys.path.insert(0, str(Path(__file__).parents[1]))
from small_run import make_envs, small_config

FILES = ("references.json", "references.csv", "references.png", "model/config.json")


def short() -> TrainingConfig:
    return dataclasses.replace(
        small_config(), first_epochs=1, total_episodes=10, final_evaluation_episodes=4, reference_episodes=3
    )


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    Trainer(make_envs, short(), 7, folder).run()
    return folder


def test_the_trained_controller_is_measured_beside_three_references(finished):
    comparison = read_comparison(finished)
    assert list(comparison.costs) == ["deepkoco", ZERO, RANDOM, EDMDC]
    table = pd.read_csv(finished / "references.csv").set_index("name")
    np.testing.assert_allclose(
        table["mean"], [costs.mean() for costs in comparison.costs.values()], rtol=1e-6
    )
    assert (table["start_states"] == 3).all()


def test_zero_action_costs_what_the_environment_says(finished):
    """From the first start states of the final evaluation, by hand."""
    from deepkoco.agent.seeding import Purpose, derive_seed

    envs = make_envs(3, 0)
    envs.reset(seed=derive_seed(7, Purpose.FINAL_EVALUATION))
    total = sum(-envs.step(np.zeros((3, 1), np.float32))[1] for _ in range(45))
    np.testing.assert_allclose(read_comparison(finished).costs[ZERO], total, rtol=1e-5)


def test_the_line_is_in_the_metadata_of_the_model(finished):
    line = json.loads((finished / "references.json").read_text())["line"]
    assert line == read_comparison(finished).line
    assert json.loads((finished / "model" / "config.json").read_text())["training"]["comparison"] == line
    assert line in (finished / "model" / "README.md").read_text()


def test_a_run_stopped_before_its_comparison_ends_with_the_same_bytes(finished, tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(run_comparison, "write_comparison", stop)
        with pytest.raises(KeyboardInterrupt):
            Trainer(make_envs, short(), 7, tmp_path).run()
    assert not (tmp_path / "model").exists()
    Trainer(make_envs, short(), 7, tmp_path).run()
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (finished / name).read_bytes(), name


def test_the_comparison_can_be_left_out(tmp_path):
    Trainer(make_envs, dataclasses.replace(short(), reference_episodes=0), 7, tmp_path).run()
    assert read_comparison(tmp_path) is None
    assert "comparison" not in json.loads((tmp_path / "model" / "config.json").read_text())["training"]
    with pytest.raises(TrainingConfigError, match="reference_episodes = -1"):
        dataclasses.replace(short(), reference_episodes=-1).check()


@pytest.mark.parametrize(
    "changes",
    [
        {"costs": {}},
        {"costs": {"other": [1.0]}},
        {"costs": {"deepkoco": [1.0], "zero action": [1.0, 2.0]}},
        {"costs": {"deepkoco": 1.0}},
        {"costs": {"deepkoco": []}},
        {"costs": None},
        {"advice": "text"},
        {"left_out": {"EDMDc + planner": 3}},
        {"left_out": []},
        {"kept": 1},
    ],
)
def test_a_damaged_file_is_named(changes, tmp_path):
    whole = {"agent": "deepkoco", "costs": {"deepkoco": [1.0]}, "left_out": {}, "advice": []}
    (tmp_path / "references.json").write_text(json.dumps(whole))
    assert read_comparison(tmp_path).agent == "deepkoco"
    (tmp_path / "references.json").write_text(json.dumps(whole | changes))
    with pytest.raises(CheckpointError, match=r"references\.json: damaged"):
        read_comparison(tmp_path)
