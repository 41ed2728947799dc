"""Seeds for every purpose of a run, derived from its one seed."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What a seed is for. Training and evaluation draw from disjoint ranges."""

    WEIGHTS = 0
    SAMPLING = 1
    NOISE = 2
    TRAINING_EPISODES = 3
    EVALUATION = 4
    FINAL_EVALUATION = 5
    FORWARD_MODEL = 6
    REFERENCES = 7


_RANGE = 2**29


def derive_seed(run_seed: int, purpose: Purpose, index: int = 0) -> int:
    """Derive a seed.

    Args:
        run_seed: The run's seed.
        purpose: What for.
        index: Iteration or round.

    Returns:
        A seed below 2^31. Evaluation seeds lie above 2^30, all others below 2^30 - 2^29 + the number of
        environments, as vector environments count up from the seed they are given.
    """
    drawn = int(np.random.SeedSequence([run_seed, int(purpose), index]).generate_state(1)[0]) % _RANGE
    return drawn + (2 * _RANGE if purpose >= Purpose.EVALUATION else 0)
