"""The comparison of our SAC with that of stable-baselines3."""

import json

import pytest

from experiments.studies.learning import sac_comparison


def test_wrong_numbers_are_named(capsys):
    assert sac_comparison.main(["--steps", "300"]) == 2
    assert "--steps 300: give a multiple of 200" in capsys.readouterr().err


def test_our_settings_are_those_of_stable_baselines3():
    config = sac_comparison.our_config(10_000, 5)
    config.check()
    assert config.total_episodes == 50
    assert (config.actor_every, config.target_every, config.steps_per_update) == (1, 1, 1)


def test_blocks_take_turns():
    order = []
    learners = {name: lambda updates, name=name: order.append((name, updates)) for name in "ab"}
    times = sac_comparison.time_in_turns(learners, 3, 7)
    assert order == [("a", 7), ("b", 7)] * 3
    assert set(times) == {"a", "b"}


@pytest.mark.bench
def test_both_train_and_are_timed(capsys, monkeypatch):
    pytest.importorskip("stable_baselines3", reason="needs the bench extra: make bench")
    monkeypatch.setattr(sac_comparison, "BLOCKS", 2)
    monkeypatch.setattr(sac_comparison, "BLOCK_UPDATES", 3)
    monkeypatch.setattr(sac_comparison, "FIRST", 380)
    assert sac_comparison.main(["--seeds", "0", "1", "--steps", "400", "--episodes", "2", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    for name in ("ours", "stable_baselines3"):
        assert len(result[name]["runs"]) == 2
        assert result[name]["cpu_ms"]["mean"] > 0
        assert result[name]["training_cost"]["mean"] > 500
