"""Accelerations of compiled trees against MuJoCo's own."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems.system import Motion
from tests.systems.trees.random_trees import columns, mujoco_accelerations, random_motions, random_tree


def difference(seed: int, motions: int = 3) -> float:
    """Largest difference from MuJoCo's accelerations, relative to the largest acceleration of the same motion."""
    model, system = random_tree(seed)
    angles, speeds, controls, loads = random_motions(np.random.default_rng(seed), model, motions)
    wanted = mujoco_accelerations(model, angles, speeds, controls, loads)
    parameters = system.default_parameters()
    shaped = tuple(system.shape_command(k, u, u, parameters) for k, u in enumerate(columns(controls)))
    motion = Motion(columns(angles), columns(speeds), shaped, columns(loads))
    found = torch.stack(system.accelerations(parameters)(motion), -1).numpy()
    return float((np.abs(found - wanted).max(-1) / np.abs(wanted).max(-1)).max())


@pytest.mark.parametrize("block", range(10))
def test_accelerations_of_200_random_trees_equal_mujoco(block):
    worst = max(difference(seed) for seed in range(20 * block, 20 * block + 20))
    assert worst < 1e-8


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(1000, 2**31))
def test_accelerations_of_any_random_tree_equal_mujoco(seed):
    assert difference(seed, 1) < 1e-8
