"""Planner metrics of an evaluation."""

import gymnasium
import numpy as np
import pandas as pd
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.collection import collect_episodes
from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.metrics import MetricsLog
from deepkoco.agent.planner_metrics import planner_metrics
from deepkoco.koopman import ModelConfig
from deepkoco.planning import PlannerConfig, PlannerConfigError

LIMIT = np.array([2.0])


def evaluate(model, horizon=5):
    envs = gymnasium.make_vec("Pendulum-v1", num_envs=2, vectorization_mode="sync", max_episode_steps=20)
    agent = VectorAgent(model, PlannerConfig(horizon), -LIMIT, LIMIT, 2, diagnostics=True)
    return agent, collect_episodes(envs, agent, 3)


def test_planned_costs_meet_the_costs_of_the_episodes(model):
    agent, episodes = evaluate(model)
    costs = [episode.costs.double().numpy() for episode in episodes]
    row, clock = planner_metrics(agent, costs, 5)
    # 20 steps: the plans of steps 0 .. 14 have their 5 predicted steps behind them
    realised = np.mean([c[k + 1 : k + 6].sum() for c in costs for k in range(15)])
    planned = np.mean([costs[:15] for costs in agent.planned_costs])
    assert row["planner/realised_cost"] == pytest.approx(realised, rel=1e-6)
    assert row["planner/planned_cost"] == pytest.approx(planned)
    assert -1 <= row["planner/cost_correlation"] <= 1
    assert row["planner/conditioning"] > 1
    assert clock["planner/microseconds"] > 0
    assert clock["planner/refined"] == agent.statistics.refined / agent.statistics.plans
    assert not set(clock) & set(row)


def test_no_evaluation_gives_the_same_columns(model):
    agent, episodes = evaluate(model)
    row, _ = planner_metrics(None, [], 5)
    assert list(row) == list(
        planner_metrics(agent, [episode.costs.double().numpy() for episode in episodes], 5)[0]
    )
    assert np.isnan(list(row.values())).all()


def test_the_wall_clock_goes_to_the_events_only(tmp_path):
    log = MetricsLog(tmp_path, [])
    log.add({"episodes": 4, "planner/iterations": 2.0}, {"planner/microseconds": 8.0})
    log.close()
    assert list(pd.read_csv(tmp_path / "metrics.csv")) == ["episodes", "planner/iterations"]
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert events.Scalars("planner/microseconds")[0].value == 8.0
    assert events.Scalars("planner/iterations")[0].value == 2.0


def test_planning_along_the_plan_without_a_decoder_is_refused_before_any_work():
    config = TrainingConfig(planner=PlannerConfig(5, linearisation="along_plan"))
    with pytest.raises(PlannerConfigError, match="rollout=updated"):
        config.check()
    config.rollout, config.model = "updated", ModelConfig(decoder_hidden=(8,))
    config.check()
