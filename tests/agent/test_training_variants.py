"""Variants of the method from training to control, aborted on the way."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepkoco.agent import Trainer, load_policy
from deepkoco.agent.action_value import ActionValueConfig
from deepkoco.koopman import ExportedModel, ModelConfig
from deepkoco.planning import PlannerConfig

sys.path.insert(0, str(Path(__file__).parent))
from small_run import make_envs, small_config

SMALL = {"first_epochs": 2, "total_episodes": 10, "iteration_updates": 8, "checkpoint_updates": 5}
VARIANTS = {
    "four rows of C": {"model": ModelConfig(2, 0.05, (8, 8), (8,), cost_rank=4)},
    "B and C at every step": {
        "model": ModelConfig(2, 0.05, (8, 8), (8,), cost_rank=2, decoder_hidden=(8,)),
        "rollout": "updated",
        "planner": PlannerConfig(5, linearisation="along_plan"),
    },
    "separate windows": {"window_stride": 6, "chunk_length": 6, "chunks": 20},
    "discounted costs": {"cost_discount": 0.9},
    "a value of actions": {"value": ActionValueConfig(discount=0.9, hidden=(8,)), "scale": True},
    "smaller steps, best weights": {"final_learning_rate": 0.1, "keep": "best"},
    "units of the task, planned first episodes": {"scale": True, "relative_cost": 0.05, "warm_start": 0.7},
}


class Abort(Exception):
    """Stands for a kill right after a checkpoint."""


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_trains_resumes_bit_for_bit_and_controls(name, tmp_path, monkeypatch):
    config = replace(small_config(), **SMALL, **VARIANTS[name])
    whole, aborted = tmp_path / "whole", tmp_path / "aborted"
    whole.mkdir()
    aborted.mkdir()
    Trainer(make_envs, config, 7, whole).run()

    trainer = Trainer(make_envs, config, 7, aborted)
    save, saved = trainer._save, []

    def save_and_abort(started: float) -> None:
        save(started)
        saved.append(started)
        if len(saved) == 2:
            raise Abort

    monkeypatch.setattr(trainer, "_save", save_and_abort)
    with pytest.raises(Abort):
        trainer.run()
    assert not (aborted / "model").exists()
    Trainer(make_envs, config, 7, aborted).run()

    weights = [(folder / "model" / "model.safetensors").read_bytes() for folder in (whole, aborted)]
    assert weights[0] == weights[1]
    policy = load_policy(whole)
    actions = [policy.act(np.array([1.0, 0.1 * k, 0.0])) for k in range(6)]
    assert np.isfinite(actions).all()
    assert policy.statistics.failures == 0
    if isinstance(policy.model, ExportedModel):  # EDMDc, which may be kept, has a rank of its own
        assert policy.model.cost_rank == config.model.cost_rank
