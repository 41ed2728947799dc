"""What actions cost is told from what they do to the state."""

import numpy as np
import pytest
import torch

from deepkoco.agent.action_cost import measure_action_cost
from deepkoco.agent.buffer import Episode


def episodes(price, count=40, steps=150):
    """Two actions of unlike range push two masses; the cost of the state is no square of it."""
    generator, found = np.random.default_rng(0), []
    limits = np.array([1.0, 10.0])
    for _ in range(count):
        noise, action, state = np.zeros(2), np.zeros(2), generator.normal(size=(2, 2))
        rows = []
        for _ in range(steps):
            cost = np.abs(state[0]).sum() + 3.0 * (np.abs(state[1]) > 2.0).sum() + price @ action**2
            rows.append((state.ravel().copy(), action.copy(), cost))
            state[0] += 0.1 * state[1]
            state[1] += 0.1 * action / limits - 0.02 * state[1]
            noise = 0.85 * noise + 0.25 * generator.normal(size=2) * limits
            action = np.clip(action + noise, -limits, limits)
        found.append(Episode(*(torch.tensor(np.array(part)).float() for part in zip(*rows, strict=True))))
    return found


def test_the_price_of_each_action_is_found_beside_a_cost_of_the_state_that_is_no_square():
    found = measure_action_cost(episodes(np.array([2.0, 0.05])))
    assert found == pytest.approx([2.0, 0.05], rel=0.2)


def test_actions_that_cost_nothing_themselves_have_no_price_although_costs_follow_them():
    assert measure_action_cost(episodes(np.zeros(2))).tolist() == [0.0, 0.0]


def test_too_few_steps_tell_nothing():
    assert measure_action_cost(episodes(np.array([2.0, 0.05]), count=2, steps=10)).tolist() == [0.0, 0.0]
