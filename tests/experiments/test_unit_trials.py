"""Trained policies on a unit, in simulated time."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepkoco.agent.collection import collect_episodes
from deepkoco.agent.forward_fit import ForwardFitConfig
from deepkoco.agent.policy import load_policy
from deepkoco.agent.replay_files import write_replay
from deepkoco.cli.command_line import main
from deepkoco.envs.unit_env import UnitEnv
from deepkoco.runs.delayed import forward_model_of
from deepkoco.runs.environments import make_environments
from deepkoco.runs.settings import ExperimentError, TaskConfig
from deepkoco.runs.train import load_run_config
from deepkoco.runs.unit_trials import (
    Bridging,
    Trial,
    as_json,
    check_run,
    interval,
    policy_names,
    run_trials,
    summarise,
)
from deepkoco.unit import make_unit

UNIT = Path(__file__).resolve().parents[2] / "configs" / "units" / "rod_pendulum_healthy.yaml"


@pytest.fixture(scope="module")
def unit():
    return make_unit("rod_pendulum", seed=3)


@pytest.fixture(scope="module")
def runs(make_run, tmp_path_factory):
    """Two policies in folders of the same name."""
    folder = tmp_path_factory.mktemp("runs")
    return [make_run(folder / name / "seed_0", seed=i) for i, name in enumerate(("none", "copies"))]


def test_runs_with_the_same_folder_name_stay_apart(runs, unit):
    trials = run_trials(runs, unit, 2, clock="simulated")
    assert [(t.policy, t.episode) for t in trials] == [
        ("none/seed_0", 0),
        ("copies/seed_0", 0),
        ("none/seed_0", 1),
        ("copies/seed_0", 1),
    ]
    summary = summarise(trials)
    assert {name: row["episodes"] for name, row in summary.items()} == {"none/seed_0": 2, "copies/seed_0": 2}
    assert summary["none/seed_0"]["mean"] == pytest.approx((trials[0].cost + trials[2].cost) / 2)


def test_a_trial_costs_what_the_policy_costs_in_the_environment(runs, unit):
    (trial,) = run_trials(runs[:1], unit, 1, clock="simulated", seed=5)
    env, policy = UnitEnv(unit, "simulated"), load_policy(runs[0])
    observation, _ = env.reset(seed=int(np.random.SeedSequence([5, 0]).generate_state(1)[0] >> 1))
    total, ended = 0.0, False
    while not ended:
        observation, reward, _, ended, _ = env.step(policy.act(observation))
        total -= float(reward)
    env.close()
    assert trial.cost == pytest.approx(total, rel=1e-12)


def test_names_are_the_shortest_that_tell_runs_apart(tmp_path):
    given = [tmp_path / "a" / "seed_0", tmp_path / "b" / "seed_0", tmp_path / "b" / "seed_1"]
    assert policy_names(given) == ["a/seed_0", "b/seed_0", "seed_1"]
    assert policy_names([tmp_path / "x" / "baseline", tmp_path / "x" / "extended"]) == [
        "baseline",
        "extended",
    ]


def test_a_run_given_twice_is_refused(tmp_path):
    with pytest.raises(ExperimentError, match="twice"):
        policy_names([tmp_path / "a", tmp_path / "b" / ".." / "a"])


def test_a_policy_that_does_not_fit_the_unit_is_refused_before_anything_moves(make_run, tmp_path, unit):
    swapped = make_run(tmp_path / "units", TaskConfig("e", "deepkoco/RodPendulum-v0"))
    with pytest.raises(ExperimentError, match="action_units"):
        check_run(swapped, unit)
    with pytest.raises(ExperimentError, match="5 observation entries, the unit gives 3"):
        check_run(make_run(tmp_path / "entries", entries=5), unit)
    other = TaskConfig("e", "deepkoco/Pendulum-v0", "pendulum", {"action_units": "physical"})
    with pytest.raises(ExperimentError, match="unit is a rod_pendulum"):
        run_trials([make_run(tmp_path / "system", other)], unit, 1, clock="simulated")


def test_the_distractors_of_the_run_belong_to_its_observation(make_run, tmp_path, unit):
    check_run(make_run(tmp_path / "copies", distractors="copies", entries=15), unit)


def trial(policy, episode, cost):
    return Trial(policy, episode, cost, cost < 100.0, overruns=episode)


def test_savings_are_paired_by_episode():
    trials = [trial("a", 0, 100.0), trial("b", 1, 150.0), trial("b", 0, 90.0), trial("a", 1, 160.0)]
    summary = summarise(trials)
    # Both episodes save 10, so the paired interval has no width although the costs differ by 60.
    assert summary["b"]["saved_against_first"] == {"mean": 10.0, "low": 10.0, "high": 10.0}
    assert summary["a"]["saved_against_first"]["mean"] == 0.0
    assert (summary["b"]["mean"], summary["b"]["median"]) == (120.0, 120.0)
    assert (summary["b"]["upright"], summary["b"]["overruns"]) == (0.5, 1)
    assert summary["a"]["low"] >= 100.0
    assert summary["a"]["high"] <= 160.0


def test_the_interval_of_one_value_is_not_known():
    mean, low, high = interval(np.array([7.0]))
    assert mean == 7.0
    assert math.isnan(low)
    assert math.isnan(high)
    row = json.loads(as_json(summarise([trial("a", 0, 7.0)])))["a"]
    assert (row["mean"], row["low"], row["high"]) == (7.0, None, None)
    assert row["saved_against_first"] == {"mean": 0.0, "low": None, "high": None}


def test_few_episodes_give_the_range_and_the_command_says_so(runs, capsys):
    values = np.array([3.0, 5.0, 4.0])
    assert interval(values) == (4.0, 3.0, 5.0)
    options = ["--unit", str(UNIT), "--clock", "simulated", "--episodes", "2"]
    assert main(["trial", str(runs[0]), *options]) == 0
    assert "[ ]: lowest and highest cost" in capsys.readouterr().out


def test_interval_of_a_mean_is_near_that_of_the_normal_law():
    values = np.random.default_rng(0).normal(10.0, 2.0, 400)
    mean, low, high = interval(values)
    half = 1.96 * values.std(ddof=1) / 20.0
    assert (low, high) == pytest.approx((mean - half, mean + half), abs=0.03)


@pytest.mark.study
def test_the_command_writes_trials_and_films(runs, tmp_path, capsys):
    out = tmp_path / "out"
    options = ["--unit", str(UNIT), "--episodes", "1", "--clock", "simulated"]
    assert main(["trial", str(runs[0]), str(runs[1]), *options, "--out", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    table = pd.read_csv(out / "trials.csv")
    assert table["policy"].tolist() == list(printed) == ["none/seed_0", "copies/seed_0"]
    assert (out / "none" / "seed_0.webm").stat().st_size > 0
    assert (out / "copies" / "seed_0.webm").stat().st_size > 0
    assert main(["trial", str(runs[0]), *options, "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_bad_input_is_one_line(runs, make_run, tmp_path, capsys):
    options = ["--unit", str(UNIT), "--clock", "simulated"]
    assert main(["trial", str(runs[0]), *options, "--episodes", "0"]) == 2
    assert main(["trial", str(tmp_path / "nothing"), *options]) == 2
    assert main(["trial", str(make_run(tmp_path / "r", entries=4)), *options]) == 2
    assert main(["trial", str(runs[0]), str(runs[0]), *options]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 4
    assert all(line.startswith("deepkoco trial: ") for line in errors)


def test_a_trial_bridges_delays_by_the_numbers_of_the_samples(make_run, tmp_path):
    run = make_run(tmp_path / "run")
    envs = make_environments(load_run_config(run))(4, 0)
    write_replay(run, 0, collect_episodes(envs, Nothing(), 1))
    forward_model_of(run, 0.05, 0, ForwardFitConfig((8,), updates=50))
    effects = {"sensing_delay": {"delay": 0.04}, "actuation_delay": {"delay": 0.05}}
    late = make_unit("rod_pendulum", seed=3, effects=effects)
    (plain,), (bridged,) = (
        run_trials([run], late, 1, clock="simulated", bridging=how) for how in (None, Bridging(0.05))
    )
    assert plain.cost != bridged.cost
    assert main(["trial", str(run), "--unit", str(UNIT), "--episodes", "1", "--clock", "simulated",
                 "--actuation-delay", "-1"]) == 2  # fmt: skip


def test_an_observation_of_a_unit_is_as_old_as_its_sensor_is_late():
    late = make_unit("rod_pendulum", seed=3, effects={"sensing_delay": {"delay": 0.04}})
    env = UnitEnv(late, "simulated")
    env.reset(seed=0)
    ages, times = [], []
    for _ in range(5):
        *_, info = env.step(np.zeros(1, np.float32))
        ages.append(info["observation_age"])
        times.append(info["time"])
    # Samples come every 10 ms; a tick comes 2 ms after one.
    assert all(0.04 <= age < 0.0521 for age in ages)
    np.testing.assert_allclose(np.diff(times), 0.05, atol=1e-9)
    env.close()


class Nothing:
    """Zero torque."""

    def reset(self):
        pass

    def act(self, observations):
        return np.zeros((len(observations), 1))
