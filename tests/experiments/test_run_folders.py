"""Which folders training makes, refuses, resumes and clears away."""

import json
import os
import sys

import pandas as pd
import pytest
import yaml

from deepkoco.runs.evaluate import evaluate
from deepkoco.runs.hydra_command import run_command
from deepkoco.runs.settings import EvaluateConfig, ExperimentError, TaskConfig, TrainRunConfig
from deepkoco.runs.train import load_run_config, prepare_folder, train
from experiments.benchmarks import planner_benchmark


@pytest.fixture
def call_train(monkeypatch, small):
    """Runs the command in this process; gives its exit status."""

    def call(*arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", ["train", *arguments, *small])
        try:
            run_command("train", train)
        except SystemExit as stop:
            return int(stop.code or 0)
        return 0

    return call


def settings(folder, **changes) -> TrainRunConfig:
    return TrainRunConfig(TaskConfig("pendulum", "Pendulum-v1"), run=str(folder), **changes)


def test_a_run_is_never_overwritten(call_train, make_run, tmp_path, capsys):
    run = make_run(tmp_path / "run")
    assert call_train(f"run={run}") == 2
    printed = capsys.readouterr().err
    assert "exists already" in printed
    assert len(printed.strip().splitlines()) == 1


def test_unknown_settings_end_with_status_two_and_no_folder(call_train, tmp_path, capsys):
    assert call_train("agent.learningrate=1", f"run={tmp_path / 'x'}") == 2
    assert "learningrate" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_a_new_folder_appears_with_its_settings_inside(tmp_path):
    left_over = tmp_path / "run.partial"
    left_over.mkdir()
    (left_over / "half").touch()
    given = settings(tmp_path / "run", seed=4)
    assert prepare_folder(given)[1:] == (tmp_path / "run", True)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert os.listdir(tmp_path / "run") == ["config.yaml"]
    assert load_run_config(tmp_path / "run").identity() == given.identity()


def test_an_existing_run_is_gone_on_with_only_when_asked_and_of_the_same_settings(tmp_path):
    first = settings(tmp_path / "run")
    prepare_folder(first)
    with pytest.raises(ExperimentError, match="exists already"):
        prepare_folder(first)
    again = settings(tmp_path / "run", existing="resume", threads=2)
    config, folder, new = prepare_folder(again)
    assert config.identity() == first.identity()
    assert (folder, new) == (tmp_path / "run", False)
    other = settings(tmp_path / "run", existing="resume", seed=5)
    with pytest.raises(ExperimentError, match="seed = 0 instead of 5"):
        prepare_folder(other)
    other = settings(tmp_path / "run", existing="resume")
    other.agent.planner.horizon = 12
    with pytest.raises(ExperimentError, match=r"agent\.planner\.horizon = 13 instead of 12"):
        prepare_folder(other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": -1}, "seed = -1"),
        ({"threads": 0}, "threads = 0"),
        ({"existing": "overwrite"}, "refuse, resume"),
    ],
)
def test_settings_out_of_range_are_named_and_leave_no_folder(change, message, tmp_path):
    with pytest.raises(ExperimentError, match=message):
        prepare_folder(settings(tmp_path / "run", **change))
    assert not (tmp_path / "run").exists()


def test_a_run_without_a_whole_window_ends_with_two_and_frees_its_folder(call_train, tmp_path, capsys):
    assert call_train("agent.horizon=45", "agent.chunk_length=60", f"run={tmp_path / 'run'}") == 2
    assert "none of 4 episodes has the 46 steps" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_sweep_goes_on_behind_a_refused_run_and_is_started_again_as_it_was(call_train, tmp_path, capsys):
    sweep = ["-m", "seed=-1,1,2", f"run={tmp_path}/seed_${{seed}}", f"hydra.sweep.dir={tmp_path}/hydra"]
    assert call_train(*sweep) == 2
    captured = capsys.readouterr()
    assert "seed = -1" in captured.err
    assert "1 of 3 runs failed:\n  seed=-1: seed = -1; give 0 or more" in captured.err
    model = tmp_path / "seed_1" / "model" / "model.safetensors"
    assert model.exists()
    assert pd.read_csv(tmp_path / "seed_2" / "metrics.csv")["episodes"].iloc[-1] == 7

    before = model.read_bytes(), model.stat().st_mtime_ns
    sweep[1] = "seed=1,3"
    assert call_train(*sweep, "existing=resume") == 0
    assert (model.read_bytes(), model.stat().st_mtime_ns) == before
    assert f"{tmp_path}/seed_1: finished already" in capsys.readouterr().out
    assert (tmp_path / "seed_3" / "model").is_dir()


def test_an_unfinished_run_is_named_with_its_remedy(make_run, tmp_path):
    run = make_run(tmp_path / "run", finished=False)
    with pytest.raises(ExperimentError, match=f"resume={run}"):
        evaluate(EvaluateConfig(str(run)))
    with pytest.raises(ExperimentError, match="seed = -1"):
        evaluate(EvaluateConfig(str(run), seed=-1))


def test_the_spread_of_one_episode_is_not_known(make_run, tmp_path, capsys):
    # On a task that value iteration does not take, for the sake of time.
    sparse = TaskConfig(
        "pendulum", "deepkoco/RodPendulum-v0", kwargs={"action_units": "physical"}, sparse_cost=0.25
    )
    evaluate(EvaluateConfig(str(make_run(tmp_path / "run", sparse)), episodes=1, json=True))
    result = json.loads(capsys.readouterr().out)
    assert result["sd"] is None
    assert result["standard_error"] is None
    assert result["mean"] > 0
    # The cost of a run on a sparse task is a number of steps: the optimum of the dense one is no measure of it.
    assert result["optimum"] is None
    assert result["above_optimum"] is None


@pytest.mark.parametrize("text", ["agent: {colour: red}", "seed: [", "- 1", "seed: much", "\x00"])
def test_damaged_settings_are_named(text, tmp_path):
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(ExperimentError, match=r"config\.yaml"):
        load_run_config(tmp_path)


def test_settings_of_an_older_release_are_read(make_run, tmp_path):
    path = make_run(tmp_path / "run") / "config.yaml"
    stored = yaml.safe_load(path.read_text())
    del stored["existing"]
    path.write_text(yaml.safe_dump(stored))
    assert load_run_config(tmp_path / "run").existing == "refuse"


def test_the_benchmark_names_a_missing_model(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sys, "argv", ["planner_benchmark", "--model", str(tmp_path)])
    with pytest.raises(SystemExit) as stop:
        planner_benchmark.main()
    assert stop.value.code == 2
    assert "config.json" in capsys.readouterr().err


@pytest.mark.study
def test_the_optimum_of_the_same_start_states_is_told(make_run, tmp_path, capsys):
    evaluate(EvaluateConfig(str(make_run(tmp_path / "run")), episodes=8, json=True))
    result = json.loads(capsys.readouterr().out)
    # An untrained model pays far more than the optimum, which is some 140 over all start states.
    assert 40 < result["optimum"]["mean"] < 260
    assert result["above_optimum"] == pytest.approx(result["mean"] - result["optimum"]["mean"])
    assert result["above_optimum"] > 3 * result["above_optimum_standard_error"] > 0
