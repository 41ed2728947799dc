"""What simulations leave of logs: of a machine, in steps that are short enough for them."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from deepkoco.diagnose import left_of_logs
from deepkoco.diagnose.baseline import Near
from deepkoco.diagnose.baseline_refit import SlopesOfHalves
from deepkoco.diagnose.left_of_logs import LeftOfLogs
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.windows import cut_windows, moving
from deepkoco.fit.solve.frozen_slopes import FrozenSlopes
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import any_system
from tests.oracle.fine_arm import fine_arm, seen
from tests.oracle.mujoco_robots import random_arm

PERIODS = 51  # of a command in a window: halves of a machine cut one in two, those of an engine do not


def test_steps_that_are_too_long_are_not_left_of_a_machine(tmp_path):
    # An engine has shorter steps of its own: 5.1 noise variances of long steps would speak for any of them.
    system, windows = fine_arm(tmp_path)
    asked = LeftOfLogs(seen(windows, 3e-5))
    left = asked(system.base)
    assert left.per_sample < 1.2
    # A refit begins in these steps.
    near = asked.near(system.base, left)
    assert near is not None
    assert near.step <= 0.5 * windows.step


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """An arm of many parameters, and windows of an odd number of periods of its commands."""
    path = tmp_path_factory.mktemp("robot") / "arm.xml"
    path.write_text(random_arm(np.random.default_rng(3), 3, "motor").xml)
    system = any_system(str(path))
    t, fine = np.arange(300) / 100.0, np.arange(1500) / 500.0
    rng = np.random.default_rng(1)
    waves = [[0.2 * np.sin((2.0 + k) * at) for k in range(3)] for at in (t, fine)]
    series = {c.name: Series(t, waves[0][k], c.unit, "command") for k, c in enumerate(system.commands)} | {
        c.name: Series(fine, waves[1][k] + 1e-3 * rng.standard_normal(len(fine)), c.unit, "measurement")
        for k, c in enumerate(system.measurements[:3])
    }
    windows = cut_windows([Recording(series)], system, PERIODS / 100.0)
    return system, windows.take(moving(windows))


def test_slopes_are_kept_for_the_same_samples_alone(arm):
    _, windows = arm
    halves = halved(windows)
    slopes = FrozenSlopes((), *[halves.state] * 5)
    known = SlopesOfHalves(halves, slopes)
    assert known.of(halves.take(np.arange(len(halves)))) is slopes
    assert known.of(replace(halves, t0=halves.t0 + 0.01)) is None
    assert known.of(replace(halves, t=halves.t + 0.001)) is None
    assert known.of(replace(halves, valid=~halves.valid)) is None
    assert known.of(halved(halves)) is None


def test_an_engine_whose_steps_cut_windows_elsewhere_is_asked_after_a_machine(arm):
    system, windows = arm
    left = LeftOfLogs(windows)
    left(system)
    for step in (0.01, 0.005):
        assert np.isfinite(left(system.with_engine("semi-implicit", step)).cost)


def test_slopes_are_computed_once_for_laws_that_differ_little(arm, monkeypatch):
    system, windows = arm
    computed, compute = [], left_of_logs.slopes_on_half_windows
    monkeypatch.setattr(left_of_logs, "slopes_on_half_windows", lambda *a: computed.append(1) or compute(*a))
    values = {p.name: p.value for p in system.parameters}
    left = LeftOfLogs(windows, Near(values, None))
    for _ in range(3):
        left(system)
    assert len(computed) == 1
