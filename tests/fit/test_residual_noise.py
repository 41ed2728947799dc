"""Noise and scatter of time stamps from residuals, on a motor that scipy integrates and whose clock scatters."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.residuals.scatter import Scatter, jitter
from deepkoco.diagnose.residuals.whiteness import more_than_noise
from deepkoco.fit.data.windows import cut_windows, moving
from deepkoco.logs import read_log
from deepkoco.systems import load_system
from tests.oracle.own_robots import RATE, MotorUnit

MOTOR = Path(__file__).parents[2] / "docs" / "examples" / "motor.py"


def refitted(folder: Path, scatter: float, seed: int, one_clock: bool = False, **unit: float):
    """System, windows, baseline and fit of a log whose samples have scattered stamps; its commands with one clock."""
    system = load_system(f"{MOTOR}:Motor")
    path = MotorUnit(**unit).log(folder, seed=seed, seconds=8.0, jitter=scatter)
    log = read_log(
        path, channels=[(c.name, c.unit, c.kind) for c in (*system.commands, *system.measurements)]
    )
    sent = log.channels["voltage"]
    exact = replace(sent, t=np.arange(len(sent.t)) / RATE)
    if not one_clock:
        log = replace(log, channels={**log.channels, "voltage": exact})
    windows = cut_windows([log], system, 1.0)
    windows = windows.take(moving(windows))
    start = with_gauges_fixed(baseline_from(system, windows), windows)
    return system, start, *refit_sharply(start, windows)


@pytest.mark.parametrize(
    ("seed", "scatter", "one_clock"),
    [(30000, 5e-5, False), (30001, 5e-5, False), (30000, 5e-5, True), (30001, 5e-4, True)],
)
def test_scattered_stamps_of_a_computer_clock_leave_only_noise_and_are_no_cause(
    tmp_path, seed, scatter, one_clock
):
    system, start, windows, fit = refitted(tmp_path, scatter, seed, one_clock)
    # The encoder's noise is 2e-4 rad; the stamps alone scatter the angle by ten to a hundred times as much.
    assert windows.noise[0].sd < 6e-4
    assert more_than_noise(fit, windows, start) is None
    assert jitter(Scatter(system, windows, fit), 0) is None


def test_large_scatter_of_the_stamps_is_still_found_as_jitter(tmp_path):
    system, _, windows, fit = refitted(tmp_path, 2e-3, 30000)
    assert windows.stamp_sd[0] == pytest.approx(2e-3, rel=0.25)
    found = jitter(Scatter(system, windows, fit), 0)
    assert found is not None
    assert found.likelihood_ratio > 60.0
    assert found.low <= 2e-3 <= found.high


def test_exact_stamps_stay_exact_also_where_a_delay_is_missing(tmp_path):
    _, start, windows, fit = refitted(tmp_path, 0.0, 30000)
    assert not any(windows.stamp_sd)
    _, start, windows, fit = refitted(tmp_path, 0.0, 30000, delay=0.03)
    assert more_than_noise(fit, windows, start) is not None
