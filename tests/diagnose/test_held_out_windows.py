"""Held-out windows: one in four, and of every phase where a log repeats one motion."""

import numpy as np
import pytest

from deepkoco.diagnose.data import HELD_OUT, cut_data
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system

WINDOW, WINDOWS = 1.0, 25


def log(period: float, drift: float = 0.0) -> Recording:
    """A motion that repeats, on a base that slowly moves on."""
    t = np.arange(0.0, WINDOW * (WINDOWS + 0.5), 0.01)
    phase = 2.0 * np.pi * t / period
    shape = np.sin(phase) + 0.4 * np.sin(3.0 * phase + 1.0) + drift * t
    rng = np.random.default_rng(0)
    return Recording(
        {
            "torque": Series(t, np.cos(phase), "N m", "command"),
            "theta": Series(t, shape + 1e-3 * rng.standard_normal(len(t)), "rad", "measurement"),
        }
    )


def phases(period: float, drift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Phases at which held-out windows and training windows begin, in windows."""
    data = cut_data([log(period, drift)], [], make_system("rod_pendulum"), WINDOW)
    assert data.held is not None
    share = len(data.held) / (len(data.held) + len(data.train))
    assert share == pytest.approx(1.0 / HELD_OUT, abs=0.06)
    return tuple(np.round(w.t0 / WINDOW % (period / WINDOW), 2) for w in (data.held, data.train))


@pytest.mark.parametrize("period", [HELD_OUT * WINDOW, 2.0 * WINDOW])
@pytest.mark.parametrize("drift", [0.0, 0.01])
def test_training_windows_show_every_phase_that_held_out_windows_show(period, drift):
    held, trained = phases(period, drift)
    assert set(held) <= set(trained)
    assert len(set(held)) > 1


def test_a_log_that_does_not_repeat_with_the_windows_holds_out_every_fourth_one():
    data = cut_data([log(2.73)], [], make_system("rod_pendulum"), WINDOW)
    np.testing.assert_allclose(np.diff(data.held.t0), HELD_OUT * WINDOW)
