"""The study of box pushing: an episode that follows from its seed, the tables and their intervals."""

import numpy as np
import pandas as pd
import pytest

from deepkoco.planning.sampling import SamplingConfig
from experiments.studies.graph import box_pushing as study
from experiments.studies.graph.box_pushing_runs import Method, push

SMALL = Method(SamplingConfig("mppi", horizon=3, samples=4, elites=2), "past", True)


def test_an_episode_follows_from_its_seed_and_all_methods_meet_the_same_starts():
    pytest.importorskip("mujoco")
    first, film = push(SMALL, 0, starts=2, steps=3)
    again, _ = push(SMALL, 0, starts=2, steps=3)
    other, _ = push(SMALL._replace(take="newest", delays=False), 0, starts=2, steps=3)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first[0], other[0])
    assert first.shape == (4, 2)
    assert film["angles"].shape == (4, 6)


def test_closer_is_one_minus_the_ratio_of_the_means():
    """Means 2 and 4: closer by a half; with the same pairs in every draw there is no width."""
    assert study.closer(np.array([[1.0, 5.0], [3.0, 3.0]])) == pytest.approx(0.5)
    assert study.interval(np.array([[2.0, 4.0]] * 5), study.closer) == pytest.approx((0.5, 0.5, 0.5))


def test_only_episodes_that_both_have_are_compared():
    rows = [("mppi_delays", 0, 1.0), ("mppi_delays", 1, 3.0), ("mppi_without", 0, 2.0)]
    table = pd.DataFrame(
        [{"method": m, "seed": 0, "start": s, "final": d, "mean": 2.0 * d} for m, s, d in rows]
    )
    found = study.comparison(table).set_index("measure")
    assert found.loc["final", "episodes"] == 1
    assert found.loc["final", "closer"] == pytest.approx(0.5)
