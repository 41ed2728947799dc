"""What a decision takes, with and without delays to bridge."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.agent.delayed_policy import DelayedPolicy
from deepkoco.agent.policy import KoopmanPolicy
from deepkoco.output.whole_file import whole_file
from experiments.studies.learning.delays_without_retraining.methods import Policy

DECISIONS, ROUNDS = 200, 15
WARM = 50  # decisions of a round that are not timed: the plan's solver starts cold


def decision_times(policy: Policy, path: Path) -> pd.DataFrame:
    """Time decisions of the plain policy and of delayed ones in turns, so that other work falls on all.

    Args:
        policy: Trained without delays.
        path: CSV that is written: median and 95 % quantile [us] of each, and the ratio of medians to the plain one.

    Returns:
        What was written.
    """
    stored, step = policy.stored, policy.stored.model.time_step
    settings = stored.model, stored.planner, stored.action_low, stored.action_high
    acts: dict[str, Callable[[np.ndarray], object]] = {"no compensation": KoopmanPolicy(*settings).act}
    for name, forward in (("latent", None), ("observation", policy.forward)):
        for steps in (0, 2, 4, 10):
            delays = steps / 2 * step, steps / 2 * step
            acts[f"{name}, {steps} steps"] = DelayedPolicy(*settings, forward, *delays).act
        told = DelayedPolicy(*settings, forward)
        acts[f"{name}, 10 steps, time stamps"] = _told(told, 5 * step)
    rng = np.random.default_rng(0)
    times: dict[str, list[float]] = {name: [] for name in acts}
    for _ in range(ROUNDS):
        angles = rng.uniform(-np.pi, np.pi, DECISIONS + WARM)
        observations = np.stack((np.cos(angles), np.sin(angles), rng.uniform(-4, 4, len(angles))), 1)
        for name, act in acts.items():
            for k, observation in enumerate(observations):
                begin = time.perf_counter()
                act(observation)
                if k >= WARM:
                    times[name].append(1e6 * (time.perf_counter() - begin))
    plain = np.median(times["no compensation"])
    table = pd.DataFrame(
        [
            {
                "policy": name,
                "median_us": np.median(values),
                "quantile_95_us": np.quantile(values, 0.95),
                "ratio": np.median(values) / plain,
            }
            for name, values in times.items()
        ]
    )
    with whole_file(path) as partial:
        table.to_csv(partial, index=False, float_format="%.4g")
    return table


def _told(policy: DelayedPolicy, delay: float) -> Callable[[np.ndarray], object]:
    """Decisions with the time stamps of the last ten commands, of which half have arrived."""
    delays = [float("inf")] * 5 + [delay] * 5

    def act(observation: np.ndarray) -> object:
        policy.measure(delays)
        return policy.act(observation, delay)

    return act
