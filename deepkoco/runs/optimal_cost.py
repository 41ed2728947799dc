"""The best cost from given start states, by value iteration, where a task allows it."""

from __future__ import annotations

import numpy as np
from gymnasium.vector import VectorEnv

from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.optimal import TrueModel, TrueModelError, ValueIteration, play, start_states


def optimal_costs(envs: VectorEnv, seed: int, points: int = 301) -> np.ndarray | None:
    """Cost of the greedy controller of a value table, with DeepKoCo's one step of input delay.

    Args:
        envs: The environments; they are reset.
        seed: Of the reset.
        points: Of the grid, for the angle and for the speed.

    Returns:
        One for each environment (B,); None where the task is no swing-up without delays on own equations, or
        its cost is replaced.
    """
    try:
        model = TrueModel.of(envs)
        iteration = ValueIteration(model, points, points, 21)
    except TrueModelError:
        return None
    start, steps = start_states(envs, seed), episode_steps(envs)
    table = iteration.solve(steps)
    return play(model, start, steps, iteration.controller(table), input_delay=True).total.numpy()


def episode_steps(envs: VectorEnv) -> int:
    """Steps after which an episode of the package's own environments is cut."""
    inner = envs.unwrapped
    assert isinstance(inner, GraphVectorEnv)
    return inner.max_episode_steps


def paired_difference(costs: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """How much higher costs (n,) are than others of the same start states (n,), and the standard error of that."""
    difference = costs - reference
    if len(difference) < 2:
        return float(difference.mean()), float("nan")
    return float(difference.mean()), float(difference.std(ddof=1) / len(difference) ** 0.5)
