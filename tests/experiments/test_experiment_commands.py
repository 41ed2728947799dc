"""The experiment commands as a user calls them."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from deepkoco.agent.collection import SpaceError
from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.cli.command_line import main
from deepkoco.runs.aggregate import aggregate, learning_curves, read_runs
from deepkoco.runs.environments import make_factory
from deepkoco.runs.settings import ExperimentError, TaskConfig
from experiments.benchmarks.planner_benchmark import (
    CEM,
    FRESH,
    benchmark,
    random_model,
    wandering_observations,
)

ROOT = Path(__file__).resolve().parents[2]


def call(command: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", f"experiments.{command}", *arguments]
    return subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def run(tmp_path_factory, small) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "small" / "seed_3"
    done = call("train", *small, "distractors=copies", "seed=3", f"run={folder}")
    assert done.returncode == 0, done.stderr
    assert "noise-free cost" in done.stdout
    return folder


def test_a_run_leaves_settings_metrics_events_checkpoint_and_model(run):
    names = {path.name for path in run.iterdir()}
    assert names == {
        *("config.yaml", "metrics.csv", "eigenvalues.csv", "tensorboard", "checkpoint.pt", "replay", "model"),
        *("references.csv", "references.json", "references.png", "before_end.pt"),
    }
    stored = yaml.safe_load((run / "config.yaml").read_text())
    assert stored["seed"] == 3
    assert stored["agent"]["model"]["encoder_hidden"] == [8]
    assert pd.read_csv(run / "metrics.csv")["episodes"].tolist() == [4, 6, 7]
    assert json.loads((run / "model" / "config.json").read_text())["training"]["episodes"] == 7


def test_evaluation_prints_one_json_object(run, capsys):
    assert main(["evaluate", str(run), "episodes=4", "json=true"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["n"] == 4
    assert result["mean"] > 0
    assert 0 <= result["upright"] <= 1
    assert result["planner_failures"] == 0


def test_unknown_environments_and_distractors_are_named():
    with pytest.raises(ExperimentError, match="Nope-v7"):
        make_factory(TaskConfig("nope", "Nope-v7"), "none")
    with pytest.raises(ExperimentError, match="none, copies"):
        make_factory(TaskConfig("pendulum", "Pendulum-v1"), "videos")


def test_arguments_and_spaces_that_do_not_fit_are_named_before_work_starts():
    with pytest.raises(ExperimentError, match="colour"):
        make_factory(TaskConfig("pendulum", "Pendulum-v1", kwargs={"colour": 1}), "none")
    with pytest.raises(SpaceError, match="Discrete"):
        make_factory(TaskConfig("cart", "CartPole-v1"), "none")


def test_the_order_of_distractor_entries_belongs_to_the_run_seed():
    make = make_factory(TaskConfig("pendulum", "Pendulum-v1"), "copies")
    one, same, other = (make(2, seed).reset(seed=5)[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
    np.testing.assert_allclose(np.sort(one), np.sort(other))


def test_band_of_three_seeds_by_hand():
    # mean 2, standard deviation 1, t(0.975, 2) = 4.3027: half-width 4.3027 / sqrt(3) = 2.4841
    mean, low, high = mean_with_band(np.array([1.0, 2.0, 3.0]))
    assert (mean, round(low, 4), round(high, 4)) == (2.0, -0.4841, 4.4841)


def test_aggregation_averages_seeds_and_draws(run, tmp_path):
    twin = tmp_path / "twin"
    twin.mkdir()
    (twin / "config.yaml").write_text((run / "config.yaml").read_text().replace("seed: 3", "seed: 4"))
    rows = pd.read_csv(run / "metrics.csv")
    rows["evaluation/cost"] += 10.0
    rows.to_csv(twin / "metrics.csv", index=False)
    both = pd.concat([read_runs(run), read_runs(twin)])
    curves = learning_curves(both)
    last = curves[(curves["curve"] == "evaluation/cost") & (curves["episodes"] == 7)].iloc[0]
    assert last["seeds"] == 2
    assert last["iqm"] == pytest.approx(rows["evaluation/cost"].iloc[-1] - 5.0)

    aggregate(run.parent, tmp_path / "out")
    written = {p.name for p in (tmp_path / "out").iterdir()}
    assert written == {"curves.csv", "final.csv", "table.csv", "learning_curve.png", "index.html"}
    assert pd.read_csv(tmp_path / "out" / "final.csv")["seed"].tolist() == [3]
    with pytest.raises(ExperimentError, match="exists already"):
        aggregate(run.parent, tmp_path / "out")


@pytest.mark.filterwarnings("ignore:The default value of raise_error")  # inside qpsolvers
def test_a_kept_solver_beats_one_made_anew_at_every_step():
    model = random_model(4, 1, 0)
    observations = wandering_observations(model, 60)
    times = benchmark(model, np.array([-1.0]), np.array([1.0]), observations, horizon=4)
    assert times["condensed, daqp"].median < times[FRESH].median
    assert times["condensed, daqp"].median < times[CEM].median
    assert {"condensed, osqp", "sparse, osqp"} < set(times)
