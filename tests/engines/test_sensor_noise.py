"""Noise from a key and a counter: standard normal, and one stream knows nothing of another."""

import numpy as np
import pytest
import torch
from scipy import stats

from deepkoco.engines.noise import draw_keys, normal

KEYS, TICKS = 300, 300


@pytest.mark.parametrize("keys", ["drawn", "in a row"])
def test_draws_are_standard_normal_and_independent(keys: str):
    key = draw_keys(KEYS, torch.Generator().manual_seed(0)) if keys == "drawn" else torch.arange(KEYS)
    first, second = (normal(key[:, None], torch.arange(TICKS)[None], c).numpy() for c in (0, 1))
    assert stats.kstest(first.ravel(), "norm").pvalue > 1e-3
    neighbours = {
        "tick": (first[:, 1:], first[:, :-1]),
        "key": (first[1:], first[:-1]),
        "tick and key": (first[1:, :-1], first[:-1, 1:]),
        "channel": (first, second),
        "squares": (first[:, 1:] ** 2, first[:, :-1] ** 2),
    }
    for name, (a, b) in neighbours.items():
        # The correlation of n independent pairs has a standard deviation of 1 / sqrt(n).
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(a.size), name


def test_the_same_arguments_give_the_same_draw():
    key, tick = torch.tensor([3, 3, 4]), torch.tensor([7, 8, 7])
    together = normal(key, tick, 0)
    assert together.tolist() == [float(normal(k, t, 0)) for k, t in zip(key, tick, strict=True)]
    assert len(set(together.tolist())) == 3
