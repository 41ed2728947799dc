"""Commands in the place of rows that a log lost."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.logs.lost_rows import with_lost_rows
from deepkoco.logs.recording import Recording
from deepkoco.logs.series import Series

PERIOD, ROWS = 0.005, 200


def log_of(kept, shift=0.0):
    t = PERIOD * np.arange(ROWS)[kept]
    return Recording(
        {
            "torque": Series(t, 3.0 * t, "N m", "command"),
            "theta": Series(t + shift, np.sin(t), "rad", "measurement"),
        }
    )


@given(st.sets(st.integers(1, ROWS - 2), min_size=1, max_size=15))
def test_lost_rows_get_the_command_between_their_neighbours(lost):
    kept = np.setdiff1d(np.arange(ROWS), list(lost))
    found = with_lost_rows(log_of(kept)).channels
    # A command that is linear in time is that of the rows that were lost.
    np.testing.assert_allclose(found["torque"].t, PERIOD * np.arange(ROWS), atol=1e-12)
    np.testing.assert_allclose(found["torque"].value, 3.0 * PERIOD * np.arange(ROWS), atol=1e-12)
    assert sorted(lost) == np.flatnonzero(found["torque"].guessed).tolist()
    assert len(found["theta"]) == len(kept)


def test_a_log_says_how_many_rows_it_lost():
    (told,) = with_lost_rows(log_of(np.delete(np.arange(ROWS), [50, 51]))).warnings
    assert "2 rows (1 %) are missing" in told


def test_a_part_of_a_log_knows_its_lost_rows():
    part = with_lost_rows(log_of(np.delete(np.arange(ROWS), [50, 120]))).between(40 * PERIOD, 60 * PERIOD)
    series = part.channels["torque"]
    np.testing.assert_allclose(series.t[series.guessed], [50 * PERIOD])


@pytest.mark.parametrize(
    "recording",
    [
        log_of(np.arange(ROWS)),
        log_of(np.delete(np.arange(ROWS), slice(50, 80))),  # a pause
        log_of(np.sort(np.random.default_rng(0).choice(ROWS, 120, replace=False))),  # no regular loop
        log_of(np.delete(np.arange(ROWS), 50), shift=0.001),  # commands have a file of their own
    ],
)
def test_other_logs_stay_as_they_are(recording):
    assert with_lost_rows(recording) is recording
