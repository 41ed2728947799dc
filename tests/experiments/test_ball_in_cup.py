"""What is played on ball_in_cup-catch, and what is taken down."""

import numpy as np
import pandas as pd
import pytest

from experiments.studies.learning.ball_in_cup import EXPLORERS, main, play, still

SEEN = np.zeros(8)


@pytest.mark.parametrize("name", EXPLORERS)
def test_every_kind_stays_within_the_limits_and_repeats_its_draws(name):
    twice = []
    for _ in range(2):
        act = EXPLORERS[name](np.random.default_rng(3))
        twice.append(np.stack([act(SEEN) for _ in range(50)]))
    assert np.array_equal(*twice)
    assert np.abs(twice[0]).max() <= 1.0


def test_a_ball_that_is_left_alone_does_not_rise_above_its_start():
    pytest.importorskip("dm_control")
    table = play("still", still, 3, seed=1)
    assert not table["began_in_cup"].any()
    assert (table["height_m"] < 0.3).all()  # the string is 0.3 m long


@pytest.mark.study
def test_the_folder_holds_a_row_for_every_kind_and_episode(tmp_path):
    pytest.importorskip("dm_control")
    assert main(["--out", str(tmp_path / "out"), "--episodes", "2"]) == 0
    assert len(pd.read_csv(tmp_path / "out" / "episodes.csv")) == 2 * len(EXPLORERS)
    assert (tmp_path / "out" / "ball_in_cup.png").stat().st_size > 0
