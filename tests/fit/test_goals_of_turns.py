"""Goals of joints whose sensors begin again after a turn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.fit.data.goals_of_turns import TURN, in_turns_of

T = 0.01 * np.arange(1000)
WAY = 6.0 * np.sin(0.9 * T)  # two turns to and fro [rad]


@given(turns=st.integers(-3, 3), wraps=st.booleans())
def test_goals_follow_the_turns_of_the_position(turns, wraps):
    shown = WAY % TURN
    goal = (WAY + 0.1) % TURN if wraps else WAY + 0.1 + turns * TURN
    position = np.unwrap(shown)
    found = in_turns_of(T, goal, T, position, shown)
    assert found - position == pytest.approx(0.1)


def test_goals_of_a_sensor_that_counts_turns_stay_as_they_are():
    goal = WAY + TURN
    assert in_turns_of(T, goal, T, WAY, WAY) is goal


def test_a_goal_may_jump_by_a_turn_where_the_position_follows_it():
    goal = np.where(T < 5.0, 0.1, 2.0 * TURN)  # more than a turn: it does not begin again
    position = np.interp(T, [0.0, 5.0, 8.0, 10.0], [0.1, 0.1, 2.0 * TURN, 2.0 * TURN])
    found = in_turns_of(T, goal, T, position, position % TURN)
    assert found == pytest.approx(goal)


def test_a_step_over_the_seam_by_the_short_way_is_followed_that_way():
    # From 170 to -100 deg: 90 deg onwards for a sensor that turns once around, 270 back for the numbers.
    goal = np.radians(np.where(T < 5.0, 170.0, -100.0))
    position = np.radians(np.interp(T, [0.0, 5.0, 6.0, 10.0], [170.0, 170.0, 260.0, 260.0]))
    found = in_turns_of(T, goal, T, position, np.mod(position + np.pi, TURN) - np.pi)
    assert found == pytest.approx(np.radians(np.where(T < 5.0, 170.0, 260.0)))


def test_a_step_by_the_long_way_is_followed_that_way_although_the_sensor_crosses_its_seam():
    goal = np.radians(np.where(T < 5.0, 5.0, 355.0))
    position = np.radians(
        np.interp(T, [0.0, 5.0, 6.0, 6.2, 6.4, 10.0], [5.0, 5.0, 350.0, 362.0, 355.0, 355.0])
    )
    found = in_turns_of(T, goal, T, position, position % TURN)
    assert found == pytest.approx(goal)
