"""The study of the pool: its episodes, what it measures, and a run of one controller."""

import numpy as np
import pytest
import torch

from experiments.studies.graph.pool import GOALS, STEPS, TUNED, Episodes, goals, graph_of, measures, run


def test_episodes_follow_from_their_seed_and_hold_their_levels():
    one, again, other = (Episodes.draw(seed, 3) for seed in (1, 1, 2))
    assert torch.equal(one.pump, again.pump)
    assert not torch.equal(one.pump, other.pump)
    changes = (one.pump.diff(dim=0) != 0.0).sum(0)
    assert ((changes >= STEPS // 60 - 1) & (changes <= STEPS // 20)).all()


def test_goals_change_when_they_should():
    # 29 from the start, 30 from 1200 s, which is step 120.
    assert goals()[[0, 119, 120, -1]].tolist() == [GOALS[0][1], 29.0, 30.0, 30.0]


def test_what_is_measured_by_hand():
    """Half a degree below the goal for the first half, one above after it; the estimate is off by 0.1."""
    off = torch.where(torch.arange(STEPS) < STEPS // 2, -0.5, 1.0)
    temperature = (goals() + off).numpy()[:, None, None]
    found = measures({"temperature": temperature, "estimate": temperature + 0.1})
    assert found["mean_error_K"].item() == pytest.approx(0.75)
    assert found["overshoot_K"].item() == pytest.approx(1.0)
    assert found["error_after_refill_K"].item() == pytest.approx(1.0)
    assert found["estimation_error_K"].item() == pytest.approx(0.1)


def test_settings_meet_the_same_episodes():
    """Two equal settings do the same; a stronger one heats earlier."""
    episodes = Episodes.draw(0, 2)
    values = [(0.4, 2400.0, 0.0), (0.4, 2400.0, 0.0), (1.6, 2400.0, 0.0)]
    settings = {
        name: torch.tensor([v[i] for v in values], dtype=torch.float64) for i, name in enumerate(TUNED)
    }
    found = run(graph_of("none", {}, 100.0), episodes, settings)
    np.testing.assert_array_equal(found["temperature"][:, 0], found["temperature"][:, 1])
    assert (found["temperature"][60, 2] > found["temperature"][60, 0]).all()
    np.testing.assert_array_equal(found["delay"][:, 0], found["delay"][:, 2])
