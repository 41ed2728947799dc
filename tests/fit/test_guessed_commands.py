"""Commands of rows that a log lost, fitted as states of their windows."""

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.solve.guessed_commands import errors_of_guesses, guesses_in
from deepkoco.logs.lost_rows import with_lost_rows
from deepkoco.logs.recording import Recording
from deepkoco.logs.series import Series
from tests.oracle.slide import RATE, Car

MASS, VISCOUS, NOISE = 108.0, 190.0, 1e-6
LOST = 0.03  # share of the rows


def forces(seconds=12.0, seed=3):
    """Slow waves with jumps, one value for each row."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    waves = 80.0 * np.sin(2.0 * np.pi * 0.7 * t) + 40.0 * np.sin(2.0 * np.pi * 3.1 * t + 1.0)
    return t, waves + np.repeat(rng.uniform(-60.0, 60.0, len(t) // 50 + 1), 50)[: len(t)]


def moved(force):
    """Places of the car under held forces, in closed form: v' = (u - F_v v) / M."""
    rate, h, q, v, shown = VISCOUS / MASS, 1.0 / RATE, 0.0, 0.0, []
    fade = np.exp(-rate * h)
    for u in force:
        shown.append(q)
        end = u / VISCOUS
        q += end * h + (v - end) * (1.0 - fade) / rate
        v = end + (v - end) * fade
    return np.array(shown)


def log_without(lost, t, force, place, seed=0):
    place = place + NOISE * np.random.default_rng(seed).standard_normal(len(t))
    keep = ~lost
    return Recording(
        {
            "force": Series(t[keep], force[keep], "N", "command"),
            "q": Series(t[keep], place[keep], "m", "measurement"),
        }
    )


@pytest.fixture(scope="module")
def lost():
    """Which rows are lost: never the first ones, nor the last."""
    t, _ = forces()
    gone = np.random.default_rng(1).random(len(t)) < LOST
    gone[:5] = gone[-5:] = False
    return gone


def test_errors_of_a_parabola_are_its_second_differences():
    column, known = np.arange(30.0) ** 2, np.zeros(30, dtype=bool)
    np.testing.assert_allclose(errors_of_guesses(column, known, 1), -1.0)
    np.testing.assert_allclose(errors_of_guesses(column, known, 2), -2.0)
    known[12] = True
    assert len(errors_of_guesses(column, known, 1)) == 28 - 3  # none uses the value that is not known


def test_commands_of_lost_rows_are_found_with_the_parameters(lost):
    t, force = forces()
    recording = with_lost_rows(log_without(lost, t, force, moved(force)))
    windows = cut_windows([recording], Car(), 1.0)
    fitted, fit = refit_sharply(baseline_from(Car(), windows), windows)
    assert fit.chi2 / windows.samples < 1.1
    assert not guesses_in(fitted)  # known as well as the sensor shows
    assert fit.values["mass"] == pytest.approx(MASS, rel=1e-4)
    assert fit.values["viscous"] == pytest.approx(VISCOUS, rel=1e-4)
    in_windows = (t >= windows.t0.min()) & (t < windows.t0.max() + windows.length)
    off = fitted.commands[0].value[lost & in_windows] - force[lost & in_windows]
    before = recording.channels["force"].value[lost & in_windows] - force[lost & in_windows]
    assert np.sqrt((off**2).mean()) < 0.25 * np.sqrt((before**2).mean())


def test_the_command_that_held_on_in_a_turn_that_the_loop_skipped_is_found_too(lost):
    t, force = forces()
    held = force[np.maximum.accumulate(np.where(lost, 0, np.arange(len(t))))]
    windows = cut_windows([with_lost_rows(log_without(lost, t, force, moved(held)))], Car(), 1.0)
    fitted, fit = refit_sharply(baseline_from(Car(), windows), windows)
    assert fit.chi2 / windows.samples < 1.1
    in_windows = lost & (t >= windows.t0.min()) & (t < windows.t0.max() + windows.length)
    off = fitted.commands[0].value[in_windows] - held[in_windows]
    assert np.sqrt((off**2).mean()) < 0.25 * np.sqrt(((force - held)[in_windows] ** 2).mean())


@pytest.mark.study
def test_a_healthy_car_with_lost_rows_lacks_nothing(lost):
    t, force = forces()
    assert diagnose([log_without(lost, t, force, moved(force))], Car()).verdict == "nothing"


@pytest.mark.study
def test_a_delay_is_found_beside_lost_rows(lost):
    t, force = forces()
    late = np.concatenate([np.zeros(4), force[:-4]])
    found = diagnose([log_without(lost, t, force, moved(late))], Car())
    assert "actuation_delay" in {name for cause in found.causes for name in cause.members}
