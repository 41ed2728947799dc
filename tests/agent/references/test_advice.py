"""Proposals follow from what was measured."""

import dataclasses

import numpy as np
import pytest
import torch

from deepkoco.agent.buffer import Episode
from deepkoco.agent.references.advice import Evidence, advise
from deepkoco.agent.references.comparison import RANDOM, ZERO


def episodes(observations=None, actions=None, costs=None, steps: int = 40) -> list[Episode]:
    """Two episodes in which nothing is wrong, but for what is given for each step."""
    generator = np.random.default_rng(0)
    parts = [
        generator.uniform(-1, 1, (steps, 2)) if observations is None else observations,
        generator.uniform(-1, 1, (steps, 1)) if actions is None else actions,
        generator.uniform(0, 1, steps) if costs is None else costs,
    ]
    return [Episode(*(torch.tensor(np.asarray(part)).float() for part in parts))] * 2


def rows(costs, **last) -> list[dict[str, float]]:
    made = [{"episodes": 100.0 * i, "evaluation/cost": float(cost)} for i, cost in enumerate(costs)]
    made[-1] |= last
    return made


HEALTHY = Evidence(
    first=episodes(),
    own=episodes(),
    others={ZERO: episodes()},
    rows=rows([5, 5, 5, 5, 5, 5, 5], **{"evaluation/episodes": 10.0, "evaluation/planner_failures": 0.0}),
    low=np.array([-1.0]),
    high=np.array([1.0]),
    window=16,
    planned_time=0.65,
    total_episodes=400,
)
UNIFORM = np.random.default_rng(1).uniform(-1, 1, (40, 2))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"first": episodes(costs=np.append(np.ones(79), -100), steps=80)}, "rare rewards up to 100 count as 0.000"),
        ({"first": episodes(steps=9)}, "100 % of the first episodes end before one training window of 16 steps"),
        ({"first": episodes(costs=np.full(40, 0.99))}, "hardly varies in the first episodes (0.990"),
        ({"first": episodes(costs=np.append(np.ones(38), [0, 0]))}, "only 5 % of the steps of the first episodes cost"),
        (
            {"first": episodes(np.array([8.0, 8.0]) * UNIFORM), "others": {ZERO: episodes(UNIFORM)}},
            "7.63 times as far as those of zero action",
        ),
        ({"first": episodes(np.array([1.0, 0.01]) * UNIFORM)}, "entry 0 of the observation varies"),
        ({"first": episodes(actions=np.full((40, 1), 0.1))}, "use 0 % of the range of an action"),
        ({"rows": rows([5], **{"evaluation/episodes": 1, "evaluation/planner_failures": 10})}, "25 % of the plans"),
        ({"rows": rows([5] * 7, **{"model/largest_growth_rate": 10.0})}, "grows 665 times over one plan"),
        ({"rows": rows([5] * 7, **{"loss/latent_scale": 2.0, "loss/linear": 9.0})}, "the latent is not predicted"),
        ({"rows": rows([5] * 7, **{"loss/cost_prediction": 4.0})}, "the predicted cost is off by 2.00"),
        ({"rows": rows([9, 9, 4, 9, 9, 9, 9])}, "weights after 200 episodes cost 4.00"),
        ({"rows": rows([9, 8, 7, 6, 5, 4, 3])}, "from 6.50 to 4.50; more episodes (agent.total_episodes=800)"),
        ({"own": episodes(actions=np.ones((40, 1)))}, "100 % of the actions are at a limit"),
        ({}, "nothing measured says why"),
    ],
)  # fmt: skip
def test_every_finding_has_its_remedy(change, words):
    (first, *_) = advise(dataclasses.replace(HEALTHY, **change))
    assert words in first


def test_where_a_reference_no_better_than_noise_goes_says_nothing():
    others = {ZERO: episodes(UNIFORM), RANDOM: episodes(costs=np.full(40, 0.1))}
    change = {"first": episodes(np.array([8.0, 8.0]) * UNIFORM), "others": others}
    assert not any("as far" in text for text in advise(dataclasses.replace(HEALTHY, **change)))


def test_settings_that_an_agent_does_not_have_are_not_proposed():
    change = {
        "window": None,
        "planned_time": None,
        "first": episodes(costs=np.linspace(-100, 1, 40), steps=40),
    }
    proposals = advise(dataclasses.replace(HEALTHY, **change, rows=rows([9, 9, 4, 9, 9, 9, 9])), most=20)
    assert not [text for text in proposals if "planner" in text or "keep" in text or "rare rewards" in text]


def test_frames_have_no_spread():
    frames = [Episode(torch.zeros(40, 4, 4, 3, dtype=torch.uint8), e.actions, e.costs) for e in episodes()]
    unseen = [Episode(torch.zeros(40, 0), e.actions, e.costs) for e in episodes()]
    found = advise(dataclasses.replace(HEALTHY, first=frames, own=unseen, others={ZERO: unseen}))
    assert "nothing measured says why" in found[0]


def test_rare_rewards_are_no_cause_where_costs_to_come_were_learned():
    rare = dataclasses.replace(HEALTHY, first=episodes(costs=np.append(np.ones(79), -100), steps=80))
    assert any("rare rewards" in text for text in advise(rare, most=20))
    assert not any(
        "rare rewards" in text for text in advise(dataclasses.replace(rare, to_come=True), most=20)
    )
