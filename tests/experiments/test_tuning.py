"""Search spaces, the points that are tried, and a tuning that is stopped and repeated."""

import math
import sys

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from omegaconf import OmegaConf

from deepkoco.runs.agents import AGENTS
from deepkoco.runs.hydra_command import CONFIGS
from deepkoco.runs.settings import ExperimentError
from experiments.benchmarks.training_benchmark import read_settings
from experiments.studies.learning import tuning
from experiments.studies.learning.search_space import Dimension, SearchSpace, as_overrides, load_search_space
from experiments.studies.learning.tuning_report import chosen_yaml, trial_table

SPACES = sorted(path.stem for path in (CONFIGS / "tuning").glob("*.yaml"))


def test_values_of_a_share_by_hand():
    assert Dimension("uniform", 2.0, 4.0).value(0.25) == 2.5
    assert Dimension("log_uniform", 1e-4, 1e-2).value(0.5) == 1e-3
    # Three of four integers below 0.75.
    assert [Dimension("integer", 1, 4).value(share) for share in (0.0, 0.3, 0.74, 0.999)] == [1, 2, 3, 4]
    assert [Dimension("choice", values=["a", "b"]).value(share) for share in (0.0, 0.49, 0.5)] == [
        "a",
        "a",
        "b",
    ]
    assert Dimension("uniform", 0.0, 1.0).value(1 / 3) == 0.333


@given(st.floats(0, 1, exclude_max=True), st.floats(1e-6, 1.0), st.floats(1.1, 1e4))
def test_values_lie_in_their_range(share, low, ratio):
    for kind in ("uniform", "log_uniform"):
        assert low * 0.99 <= Dimension(kind, low, low * ratio).value(share) <= low * ratio * 1.01


def test_a_larger_budget_adds_trials_and_changes_none():
    space = SearchSpace({"a": Dimension("uniform", 0.0, 1.0), "b": Dimension("choice", values=[1, 2])})
    few, many = space.points(5, seed=1), space.points(40, seed=1)
    assert few == many[:5]
    assert few[0] == {}
    assert space.points(5, seed=2) != few
    # The sequence fills the range: every tenth of it has a point.
    shares = np.array([point["a"] for point in many[1:]])
    assert set((10 * shares).astype(int)) == set(range(10))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("space: {a: {kind: uniform, low: 2, high: 1}}", "a: low = 2 is not below high = 1"),
        ("space: {a: {kind: log_uniform, low: 0, high: 1}}", "starts above 0"),
        ("space: {a: {kind: choice, values: [1]}}", "at least two"),
        ("space: {a: {kind: normal}}", 'kind = "normal"; choose one of'),
        ("space: {}", "space is empty"),
        ("space: {a: {kind: uniform, lower: 1}}", "lower"),
        ("spaces: {}", "spaces"),
        ("space: [", "space.yaml"),
    ],
)
def test_a_wrong_space_is_named_with_its_file(tmp_path, text, problem):
    path = tmp_path / "space.yaml"
    path.write_text(text)
    with pytest.raises(ExperimentError) as caught:
        load_search_space(path)
    assert str(path) in str(caught.value)
    assert problem in str(caught.value)
    with pytest.raises(ExperimentError, match="no such search space; there are space"):
        load_search_space(tmp_path / "none.yaml")


def test_every_agent_has_a_space():
    # Imitation is as good as its teacher and its questions; there is no cost of its own to tune.
    assert set(AGENTS) - {"imitation"} <= set(SPACES)


@pytest.mark.study
@pytest.mark.parametrize("agent", [name for name in SPACES if name in AGENTS])
def test_every_space_is_of_settings_of_its_agent(agent):
    space = load_search_space(CONFIGS / "tuning" / f"{agent}.yaml")
    fixed = [text.format(episodes=150) for text in space.overrides]
    ends = [{name: own.value(share) for name, own in space.space.items()} for share in (0.0, 0.5, 0.999)]
    for values in ends:
        config = read_settings(f"agent={agent}", *fixed, *as_overrides(values))
        config.agent.check()
        for name, value in values.items():
            found = OmegaConf.select(OmegaConf.structured(config.agent), name)
            assert found == value


def test_overrides_carry_lists_and_words():
    values = {"learning_rate": 1e-05, "model.encoder_hidden": [8, 8], "transition": "ensemble"}
    assert as_overrides(values) == [
        "agent.learning_rate=1e-05",
        "agent.model.encoder_hidden=[8,8]",
        "agent.transition=ensemble",
    ]


def test_the_best_trial_is_that_of_the_lowest_mean_and_half_done_ones_do_not_count():
    rows = [
        (0, "none", 5.0, ""),
        (0, "copies", 9.0, ""),
        (1, "none", 4.0, ""),
        (1, "copies", 8.0, ""),
        (2, "none", 1.0, ""),
        (3, "none", 1.0, ""),
        (3, "copies", math.inf, "no memory"),
    ]
    runs = pd.DataFrame(rows, columns=["trial", "distractors", "cost", "error"])
    runs = runs.assign(seed=100, steps=10.0, updates=5.0, seconds=1.0)
    table = trial_table([{}, {"a": 1.5}, {"a": 2.5}, {"a": 3.5}], runs, 2)
    assert table["trial"].tolist() == [1, 0, 3]
    assert table["score"].tolist() == [6.0, 7.0, math.inf]
    assert table.loc[0, ["cost/none", "cost/copies", "a", "steps"]].tolist() == [4.0, 8.0, 1.5, 20.0]
    assert table["error"].tolist() == ["", "", "no memory"]
    stored = OmegaConf.create(chosen_yaml("sac", {"learning_rate": 0.002, "model.pairs": 3}, "trial 1"))
    assert stored == {"agent": {"learning_rate": 0.002, "model": {"pairs": 3}}}
    assert chosen_yaml("sac", {}, "trial 0").startswith("# @package _global_\n")


@pytest.fixture
def tiny(tmp_path, monkeypatch):
    """A folder of configs with a search space of one setting."""
    (tmp_path / "configs" / "tuning").mkdir(parents=True)
    space = (
        "overrides: ['agent.noise_last_episode={episodes}']\n"
        "space: {cost_weight: {kind: uniform, low: 5, high: 20}}\n"
    )
    (tmp_path / "configs" / "tuning" / "deepkoco.yaml").write_text(space)
    monkeypatch.setattr(tuning, "CONFIGS", tmp_path / "configs")
    return tmp_path


@pytest.mark.study
def test_a_repeated_call_goes_on_and_a_larger_budget_adds_trials(tiny, small, capsys):
    settings = [s for s in small if s.split("=")[0] not in ("task", "agent.total_episodes")]
    settings = [s for s in settings if "evaluation" not in s]
    call = ["--agent", "deepkoco", "--task", "gymnasium_pendulum", "--distractors", "none", "--episodes", "4"]
    call += ["--evaluation-episodes", "2", "--out", str(tiny / "out"), "--runs", str(tiny / "runs")]
    assert tuning.main([*call, "--budget", "1", "--set", *settings]) == 0
    capsys.readouterr()
    runs, out = (
        tiny / "runs" / "gymnasium_pendulum" / "deepkoco",
        tiny / "out" / "gymnasium_pendulum" / "deepkoco",
    )
    model = runs / "trial_000" / "none" / "seed_100" / "model"
    before = model.stat().st_mtime_ns
    assert not (model.parent / "replay").exists()
    assert tuning.main([*call, "--budget", "2", "--processes", "2", "--set", *settings]) == 0
    printed = capsys.readouterr().out
    assert [line for line in printed.splitlines() if line.startswith("training")] == [
        "training deepkoco, trial 1, none, seed 100"
    ]
    assert model.stat().st_mtime_ns == before
    trials = pd.read_csv(out / "trials.csv").set_index("trial")
    assert math.isnan(trials.loc[0, "cost_weight"])
    assert 5.0 <= trials.loc[1, "cost_weight"] <= 20.0
    assert trials["steps"].tolist() == [4 * 45] * 2
    stored = OmegaConf.load(runs / "trial_001" / "none" / "seed_100" / "config.yaml")
    assert (stored.agent.cost_weight, stored.agent.noise_last_episode) == (trials.loc[1, "cost_weight"], 4)
    assert set(pd.read_csv(out / "runs.csv")["trial"]) == {0, 1}
    assert {path.name for path in out.iterdir()} == {
        *("README.md", "PROVENANCE.md", "chosen.yaml", "runs.csv", "space.yaml", "trials.csv")
    }


def test_a_trial_that_fails_costs_infinitely_much_and_holds_up_no_other(tiny, capsys, monkeypatch):
    # In the place of a Python that trains: fails in the first trial, then leaves a finished run.
    python = tiny / "python"
    run = tiny / "runs" / "pendulum" / "deepkoco" / "trial_001" / "none" / "seed_100"
    columns = "evaluation/cost,evaluation/cost_sd,steps,updates,seconds"
    python.write_text(
        "#!/bin/sh\n"
        "case \"$*\" in *trial_000*) echo 'error: no disk' >&2; exit 2;; esac\n"
        f"mkdir -p {run}/model {run}/replay\n"
        f"printf '{columns}\\n9,1,200,10,1\\n7,1,400,20,2\\n' > {run}/metrics.csv\n"
    )
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    call = ["--agent", "deepkoco", "--distractors", "none", "--budget", "2"]
    assert tuning.main([*call, "--out", str(tiny / "out"), "--runs", str(tiny / "runs")]) == 2
    assert "trial_000/none/seed_100: error: no disk" in capsys.readouterr().err
    trials = pd.read_csv(tiny / "out" / "pendulum" / "deepkoco" / "trials.csv").set_index("trial")
    assert trials["score"].to_dict() == {0: math.inf, 1: 7.0}
    assert trials.loc[0, "error"] == "error: no disk"
    assert not (run / "replay").exists()


def test_runs_of_other_settings_are_refused(tiny, make_run, capsys):
    make_run(tiny / "runs" / "pendulum" / "deepkoco" / "trial_000" / "none" / "seed_100", seed=100)
    call = ["--agent", "deepkoco", "--distractors", "none", "--budget", "1"]
    assert tuning.main([*call, "--out", str(tiny / "out"), "--runs", str(tiny / "runs")]) == 2
    error = capsys.readouterr().err
    assert "holds a run with" in error
    assert "agent.noise_last_episode = 400 instead of 150" in error


def test_wrong_arguments_are_refused(tmp_path, capsys):
    call = ["--out", str(tmp_path / "out"), "--runs", str(tmp_path / "runs")]
    cases = {"--budget": "0", "--episodes": "0", "--processes": "0", "--seeds": "-1"}
    for name, value in cases.items():
        assert tuning.main(["--agent", "deepkoco", name, value, *call]) == 2
        assert name in capsys.readouterr().err
    assert tuning.main(["--agent", "human", *call]) == 2
    assert "human" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
