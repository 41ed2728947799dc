"""Ablations: their configs, their comparison, and a call that is repeated."""

import json
import sys

import numpy as np
import pandas as pd
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from deepkoco.runs.agents import register
from deepkoco.runs.hydra_command import CONFIGS
from deepkoco.runs.settings import ExperimentError, TrainRunConfig
from experiments.studies.learning.ablation_differences import differences, paired_interval
from experiments.studies.learning.ablations import available, main, with_references


def read(*overrides: str) -> TrainRunConfig:
    register()
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        config = OmegaConf.to_object(compose("train", list(overrides)))
    assert isinstance(config, TrainRunConfig)
    return config


@pytest.mark.study
@pytest.mark.parametrize("name", available()[1:])
def test_every_ablation_can_be_trained_and_changes_a_setting(name):
    config = read(f"+ablation={name}")
    config.agent.check()
    assert config.identity() != read().identity()


def test_windows_that_do_not_overlap_come_in_batches_and_updates_of_the_default_size():
    # 90 episodes of 200 steps: 185 windows each at stride 1, 12 at stride 16.
    def sizes(agent, windows):
        batch = agent.chunks * (agent.chunk_length - agent.horizon)
        later = 110 * windows // batch * agent.iteration_epochs
        return batch, 90 * windows // batch * agent.first_epochs, min(later, agent.iteration_updates)

    assert sizes(read().agent, 185) == (200, 8300, 303)
    assert sizes(read("+ablation=no_overlap").agent, 12) == (200, 8300, 300)


def test_differences_are_paired_by_seed_and_episode():
    # Seed 0: episodes 2 and 4 dearer; seed 1: 6 and 0 dearer; seed 2 has no counterpart.
    costs = {
        "default": {0: [10.0, 100.0], 1: [50.0, 20.0]},
        "changed": {0: [12.0, 104.0], 1: [56.0, 20.0], 2: [999.0, 999.0]},
        "sparse": {0: [1.0, 3.0]},
    }
    table = differences(costs, {"changed": "default", "sparse": None}).set_index("ablation")
    assert table.loc["changed", "difference"] == pytest.approx(3.0)
    assert table.loc["changed", "cost"] == pytest.approx((58.0 + 38.0 + 999.0) / 3)
    assert 0.0 <= table.loc["changed", "low"] < 3.0 < table.loc["changed", "high"] <= 6.0
    assert table.loc["sparse", "cost"] == pytest.approx(2.0)
    assert np.isnan(table.loc["sparse", "difference"])
    assert np.isnan(table.loc["default", "difference"])


def test_the_interval_is_that_of_a_normal_mean_where_episodes_vary_and_seeds_do_not():
    # One seed, 400 differences of mean 5 and standard deviation 2: 5 -+ 1.96 * 2 / 20.
    values = np.random.default_rng(1).normal(size=400)
    values = 5.0 + 2.0 * (values - values.mean()) / values.std()
    assert paired_interval([values]) == pytest.approx((4.804, 5.196), abs=0.02)


def test_the_interval_spans_seeds_that_differ():
    # Two seeds without spread: both drawn twice, or one of each: 0, 5 or 10.
    assert paired_interval([np.zeros(9), np.full(9, 10.0)]) == (0.0, 10.0)


def test_the_reference_is_added_and_unknown_names_are_refused():
    assert with_references(["rank_2"]) == ["default", "rank_2"]
    assert with_references(["sparse_discounted"]) == ["sparse", "sparse_discounted"]
    with pytest.raises(ExperimentError, match="colour"):
        with_references(["colour"])


@pytest.mark.study
def test_a_repeated_call_does_nothing_again_and_adds_what_is_new(make_run, small, tmp_path, capsys):
    out = tmp_path / "out"
    model = make_run(out / "runs" / "default" / "seed_0") / "model" / "model.safetensors"
    before = model.stat().st_mtime_ns
    call = ["--out", str(out), "--seeds", "0", "--episodes", "3", "--set", *small]
    assert main([*call, "--only", "rank_2"]) == 0
    printed = capsys.readouterr().out
    assert [line for line in printed.splitlines() if "training" in line] == ["training rank_2, seed 0"]
    assert model.stat().st_mtime_ns == before
    rows = pd.read_csv(out / "ablations.csv").set_index("ablation")
    stored = json.loads((out / "evaluations" / "rank_2" / "seed_0.json").read_text())
    assert rows.loc["rank_2", "cost"] == pytest.approx(np.mean(stored["costs"]), rel=1e-4)
    difference = pd.read_csv(out / "differences.csv").set_index("ablation").loc["rank_2", "difference"]
    assert difference == pytest.approx(rows.loc["rank_2", "cost"] - rows.loc["default", "cost"], abs=0.5)
    assert (out / "ablations.png").stat().st_size > 0
    assert main([*call, "--only", "rank_2"]) == 0
    assert "training" not in capsys.readouterr().out


def test_runs_that_fail_are_named_and_hold_up_no_other(make_run, tmp_path, capsys, monkeypatch):
    out, python = tmp_path / "out", tmp_path / "python"
    make_run(out / "runs" / "default" / "seed_0")
    damaged = make_run(out / "runs" / "rank_2" / "seed_0") / "model" / "config.json"
    damaged.write_text("{")
    # In the place of a Python that trains.
    python.write_text("#!/bin/sh\necho 'error: no disk' >&2\nexit 2\n")
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    names = ["--only", "rank_2", "rank_4"]
    assert main(["--out", str(out), "--seeds", "0", "--episodes", "2", *names]) == 2
    printed = capsys.readouterr().err
    assert f"error: rank_2, seed 0: {damaged}" in printed
    assert "error: rank_4, seed 0: error: no disk" in printed
    assert pd.read_csv(out / "ablations.csv")["ablation"].tolist() == ["default"]
