"""The benchmark of the agents: what it counts, and that it runs."""

import json

import numpy as np
import pytest

from deepkoco.runs.agents import AGENTS
from deepkoco.runs.settings import ExperimentError
from experiments.benchmarks.agent_work import PARTS, Part, count_steps
from experiments.benchmarks.agents_benchmark import main, settings_of, time_in_turns

SHORT = ["task=gymnasium_pendulum", "+task.kwargs.max_episode_steps=20"]
NETWORKS = {
    "deepkoco": ["agent.model.encoder_hidden=[8]", "agent.model.cost_hidden=[8]", "agent.first_episodes=90"],
    "sac": ["agent.hidden=8"],
}


def test_every_agent_has_its_parts():
    # Imitation learns from a teacher, whose work is not its own.
    assert set(PARTS) == set(AGENTS) - {"imitation"}


def test_a_seed_of_a_baseline_by_hand():
    config = settings_of(
        "dbc", [*SHORT, "agent.hidden=8", "agent.random_steps=100", "agent.total_episodes=50"]
    )
    assert count_steps(config) == 20
    parts = PARTS["dbc"](config, 20)
    # 50 episodes of 20 steps, of which 100 are random; evaluations after 20 and 40 of 10 episodes, at the end of 200.
    assert {name: part.of_a_seed for name, part in parts.items()} == {
        "update": 900,
        "random step": 100,
        "step": 900,
        "evaluation step": (2 * 10 + 200) * 20,
    }


def test_a_seed_of_deepkoco_by_hand():
    config = settings_of("deepkoco", [*SHORT, *NETWORKS["deepkoco"], "agent.total_episodes=130"])
    parts = PARTS["deepkoco"](config, 20)
    # 90 episodes of 5 windows: 2 batches of 200, 100 times; of 110 episodes 2, of 130 episodes 3, 3 times each.
    assert parts["update"].of_a_seed == 200 + 6 + 9
    assert parts["step by noise"].of_a_seed == 90 * 20
    # 40 episodes of training, three evaluations of 20, which choose the weights, and the last one of 200.
    assert parts["step with a plan"].of_a_seed == (40 + 60 + 200) * 20


def test_all_parts_take_turns_and_times_are_of_one_unit(monkeypatch):
    calls = []
    clock = iter(range(0, 10**9, 10**6))  # every look at it is 1 ms later
    monkeypatch.setattr("experiments.benchmarks.agents_benchmark.CLOCKS", {"wall": lambda: next(clock)})
    parts = {
        ("a", "x"): Part(lambda: calls.append("x"), 2, 0),
        ("b", "y"): Part(lambda: calls.append("y"), 1, 0),
    }
    times = time_in_turns(parts, rounds=3)
    assert calls == ["x", "y"] * 4
    np.testing.assert_allclose(times["a", "x"]["wall"], [0.5] * 3)
    np.testing.assert_allclose(times["b", "y"]["wall"], [1.0] * 3)


def test_agents_profiles_and_settings_are_read():
    assert settings_of("dbc+small", SHORT).agent.hidden == 256
    with pytest.raises(ExperimentError, match="deepkoco"):
        settings_of("deepkoco+small", SHORT)
    with pytest.raises(ExperimentError, match="human"):
        settings_of("human", SHORT)


def test_the_command_prints_one_object(capsys):
    assert main(["--rounds", "0"]) == 2
    assert "--rounds 0" in capsys.readouterr().err
    call = [
        "--agents",
        "sac",
        "--only",
        "states",
        "--task",
        "gymnasium_pendulum",
        "--rounds",
        "2",
        "--episodes",
        "2",
    ]
    own = ["+task.kwargs.max_episode_steps=20", "agent.hidden=8", "agent.random_steps=20"]
    own += ["agent.final_evaluation_episodes=2"]
    assert main([*call, "--seed-run", "--json", "--set", *own]) == 0
    result = json.loads(capsys.readouterr().out)["cases"]["states"]["sac"]
    assert result["parts"]["update"]["of_a_seed"] == 20
    assert result["parts"]["update"]["wall_ms"]["median"] > 0
    assert result["seed_run_seconds"]["wall"] > 0
    parts = result["parts"].values()
    total = sum(part["of_a_seed"] * part["cpu_ms"]["median"] for part in parts) / 1e3
    assert result["seed_seconds"]["cpu"] == pytest.approx(total)
