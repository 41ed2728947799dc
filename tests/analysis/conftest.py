"""Recorded steps of a linear system, and the latent model that describes it exactly."""

import sys
from pathlib import Path

import numpy as np
import pytest

from deepkoco.analysis.measures.steps import Steps, join_steps
from deepkoco.koopman.exported import ExportedModel

sys.path.insert(0, str(Path(__file__).parent))
from handmade_models import linear_model


@pytest.fixture
def exact() -> tuple[ExportedModel, Steps]:
    """A system o' = L o + b a with its exact latent model s = o + G a, G = (L - I)^-1 b, and cost (C s)^2.

    Then s' = L s + G da, as o' + G a' = L o + (b + G) a + G da and b + G = L G. C reads the first pair only.
    """
    factor = np.array([[1.0, 0.5, 0.0, 0.0]])
    transition = linear_model(np.eye(4, 5), factor).dynamics.matrix
    push = np.array([0.1, 0.3, -0.2, 0.1])
    gain = np.linalg.solve(transition - np.eye(4), push)
    model = linear_model(np.column_stack([np.eye(4), gain]), factor)
    generator = np.random.default_rng(0)
    episodes = []
    for length in (40, 25, 3):
        state, states = generator.normal(size=4), []
        actions = generator.normal(size=(length, 1))
        for action in actions:
            states.append(state)
            state = transition @ state + push * action[0]
        observations = np.array(states)
        costs = np.square((observations + actions * gain) @ factor[0])
        episodes.append((observations, actions, costs))
    return model, join_steps(episodes)
