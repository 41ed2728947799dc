"""Which runs are averaged, under which name, and how they are collected."""

import itertools

import numpy as np
import pandas as pd
import pytest

from deepkoco.cli.command_line import main as command_line
from deepkoco.envs.task_factory import TaskConfig
from deepkoco.planning import PlannerConfig
from deepkoco.runs.aggregate import (
    FEW,
    aggregate,
    bootstrap_interval,
    conditions,
    interquartile_mean,
    kind_of_interval,
    read_runs,
    summarise,
)
from deepkoco.runs.settings import ExperimentError
from deepkoco.runs.train import load_run_config
from experiments.studies.learning.collect_runs import collect, main


def labels(*runs):
    named = conditions({run: load_run_config(run) for run in runs})
    return [named[run] for run in runs]


def test_seeds_of_the_same_settings_are_one_condition(make_run, tmp_path):
    runs = [make_run(tmp_path / f"seed_{seed}", seed=seed) for seed in (0, 1)]
    assert labels(*runs) == ["pendulum, distractors none"] * 2
    runs.append(make_run(tmp_path / "copies", distractors="copies"))
    assert labels(*runs)[2] == "pendulum, distractors copies"


def test_runs_of_other_settings_are_told_apart_by_what_differs(make_run, tmp_path):
    one, two = make_run(tmp_path / "a", cost=100.0), make_run(tmp_path / "b", horizon=20, cost=300.0)
    third = make_run(tmp_path / "c", horizon=20, planner=PlannerConfig(20))
    assert labels(one, two) == [f"pendulum, distractors none, agent.horizon = {t}" for t in (15, 20)]
    assert labels(one, two, third)[2].endswith("agent.horizon = 20, agent.planner.horizon = 20")
    aggregate(tmp_path, tmp_path / "out")
    final = pd.read_csv(tmp_path / "out" / "final.csv")
    assert len(set(final["condition"])) == 3
    curves = pd.read_csv(tmp_path / "out" / "curves.csv")
    assert set(curves["seeds"]) == {1}


def test_other_tasks_and_observations_never_share_a_line(make_run, tmp_path):
    rod = {"id": "deepkoco/RodPendulum-v0"}
    tasks = [
        TaskConfig("pendulum", **rod),
        TaskConfig("pendulum", **rod, kwargs={"start": None}),
        TaskConfig("pendulum", "deepkoco/DiskPendulum-v0"),
        TaskConfig("disk", "deepkoco/DiskPendulum-v0"),
    ]
    runs = [make_run(tmp_path / f"{i}", task) for i, task in enumerate(tasks)]
    runs.append(make_run(tmp_path / "images", tasks[0], observation="images"))
    found = labels(*runs)
    assert len(set(found)) == 5
    assert "task.kwargs.start = not given" in found[0]
    assert "task.kwargs.start = None" in found[1]
    assert found[3:] == ["disk, distractors none", "pendulum from images, distractors none"]
    assert labels(runs[4]) == found[4:]


def test_the_same_seed_twice_is_refused(make_run, tmp_path):
    one = make_run(tmp_path / "a")
    make_run(tmp_path / "b")
    with pytest.raises(ExperimentError, match=rf"same settings and seed as {one}"):
        read_runs(tmp_path)


def test_unfinished_runs_are_left_out_with_a_warning(make_run, tmp_path, caplog):
    make_run(tmp_path / "a", seed=0)
    make_run(tmp_path / "b", seed=1, finished=False)
    assert set(read_runs(tmp_path)["seed"]) == {0}
    assert "left out what is not finished: b" in caplog.text
    with pytest.raises(ExperimentError, match="no finished run"):
        read_runs(tmp_path / "b")


def test_a_collected_run_without_its_weights_is_still_averaged(make_run, tmp_path):
    make_run(tmp_path / "a", finished=False, total_episodes=110)
    assert len(read_runs(tmp_path)) == 2


@pytest.mark.study
def test_collection_keeps_everything_but_the_weights(make_run, tmp_path, capsys):
    runs = tmp_path / "runs"
    make_run(runs / "none" / "seed_1", seed=1)
    make_run(runs / "none" / "seed_2", seed=2, finished=False)
    out = tmp_path / "out"
    assert main([str(runs), "--out", str(out), "--episodes", "2"]) == 0
    assert {path.name for path in out.iterdir()} == {
        *(
            "curves.csv",
            "final.csv",
            "table.csv",
            "learning_curve.png",
            "evaluations.csv",
            "PROVENANCE.md",
            "runs",
        )
    }
    assert sorted(p.relative_to(out).as_posix() for p in (out / "runs").rglob("*.*")) == [
        "runs/none/seed_1/config.yaml",
        "runs/none/seed_1/metrics.csv",
    ]
    row = pd.read_csv(out / "evaluations.csv").iloc[0]
    assert (row["task"], row["observation"], row["seed"]) == ("pendulum", "states", 1)
    assert (row["n"], row["train_seconds"]) == (2, 110.5)
    # Both are written to six digits.
    assert row["above_optimum"] == pytest.approx(row["mean"] - row["optimum"], rel=1e-4)
    assert row["above_optimum"] > 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "runs"]
    assert main([str(runs), "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_collection_that_fails_leaves_no_folder(make_run, tmp_path):
    runs = tmp_path / "runs"
    run = make_run(runs / "seed_1")
    (run / "model" / "config.json").write_text("{")
    with pytest.raises(ExperimentError, match="seed_1"):
        collect(runs, tmp_path / "out", 1)
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]
    with (run / "config.yaml").open("a") as file:
        file.write("colour: red\n")
    assert main([str(runs), "--out", str(tmp_path / "out")]) == 2


def test_the_interquartile_mean_and_its_interval_by_hand():
    # The lowest and the highest of five are left out: (2 + 3 + 7) / 3 = 4.
    assert interquartile_mean(np.array([7.0, 1.0, 3.0, 100.0, 2.0])) == 4.0
    # Of two seeds a resample is (a, a), (a, b), (b, a) or (b, b): the interval is from one to the other.
    assert bootstrap_interval(np.array([5.0, 9.0])) == (5.0, 9.0)
    assert all(np.isnan(bootstrap_interval(np.array([5.0]))))


def test_the_table_has_one_row_per_condition_and_its_number_of_seeds(make_run, tmp_path, capsys):
    runs = tmp_path / "runs"
    for seed, cost in enumerate((150.0, 160.0, 170.0)):
        make_run(runs / f"seed_{seed}", seed=seed, cost=cost)
    make_run(runs / "copies", distractors="copies", cost=200.0)
    assert command_line(["aggregate", str(runs)]) == 0
    assert "162.7" in capsys.readouterr().out
    table = pd.read_csv(tmp_path / "runs_summary" / "table.csv").set_index("condition")
    assert table["n"].to_dict() == {"pendulum, distractors copies": 1, "pendulum, distractors none": 3}
    row = table.loc["pendulum, distractors none"]
    # The last row of a run of `make_run` costs 300 / 110 more than its cost.
    spread = pytest.approx([162.727, 162.727, 152.727, 172.727])
    assert row[["iqm", "median", "best", "worst"]].tolist() == spread
    assert row["best"] <= row["low"] < row["iqm"] < row["high"] <= row["worst"]
    assert command_line(["aggregate", str(runs)]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.parametrize("seeds", range(2, FEW + 3))
def test_fewer_seeds_than_an_interval_takes_give_the_range_and_say_so(seeds):
    costs = np.random.default_rng(seeds).uniform(100.0, 200.0, seeds)
    limits = bootstrap_interval(costs)
    whole = (costs.min(), costs.max())
    if seeds < FEW:
        assert (limits, kind_of_interval(seeds)) == (whole, "range")
    else:
        assert kind_of_interval(seeds) == "95 %"
        assert whole[0] < limits[0] < limits[1] < whole[1]


@pytest.mark.parametrize("seeds", range(2, FEW))
def test_a_bootstrap_of_few_seeds_has_nothing_but_the_range_to_give(seeds):
    """The chance that the interquartile mean of a resample is the lowest cost, counted over all resamples."""
    costs = np.arange(seeds, dtype=float)
    resamples = np.array(list(itertools.product(costs, repeat=seeds)))
    assert (interquartile_mean(resamples, axis=1) == costs[0]).mean() > 0.025
    more = np.array(list(itertools.product(np.arange(FEW, dtype=float), repeat=FEW)))
    assert (interquartile_mean(more, axis=1) == 0.0).mean() < 0.025


def test_the_table_and_its_text_name_the_kind_of_interval(make_run, tmp_path):
    for seed in range(2):
        make_run(tmp_path / "runs" / f"seed_{seed}", seed=seed, cost=100.0 + seed)
    told = summarise(tmp_path / "runs", None)
    assert "an interval takes 5 seeds or more" in told
    assert "95 % bootstrap" not in told
    table = pd.read_csv(tmp_path / "runs_summary" / "table.csv")
    assert table["interval"].tolist() == ["range"]
