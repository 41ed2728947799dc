"""A log that goes beyond what the healthy logs cover."""

import numpy as np

from deepkoco.diagnose.baseline import Baseline, Healthy, baseline_from
from deepkoco.diagnose.verdict.healthy_range import beyond_healthy, range_advice
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system

SYSTEM = make_system("servo_pendulum")
LAG = 0.033


def swung(amplitude: float, frequency: float) -> Recording:
    """The servo follows a sine, late by its damping over its stiffness."""
    t = np.arange(0.0, 6.0, 0.01)
    angle = amplitude * np.sin(2.0 * np.pi * frequency * t)
    late = amplitude * np.sin(2.0 * np.pi * frequency * (t - LAG)) + 1e-3 * np.random.default_rng(1).normal(
        size=t.size
    )
    channels = {"goal": Series(t, angle, "rad", "command"), "theta": Series(t, late, "rad", "measurement")}
    return Recording(channels=channels, path=None)


def problem_of(recording: Recording):
    windows = cut_windows([recording], SYSTEM, 1.0)
    start = baseline_from(SYSTEM, windows)
    problem = FitProblem(start.system, windows)
    return start, problem, problem.evaluate(start.values)


def learned(recording: Recording):
    start, problem, fit = problem_of(recording)
    return Baseline(
        start.system,
        start.values,
        start.prior,
        healthy=Healthy((recording,), problem.windows, start, (), fit),
    )


def test_a_faster_motion_is_beyond_the_healthy_logs_and_a_slower_one_is_not():
    start = learned(swung(0.5, 0.5))
    _, problem, fit = problem_of(swung(0.5, 1.0))
    (only,) = beyond_healthy(start, problem, fit)
    assert only.name == SYSTEM.state_names[1]
    # Peak speeds of 0.5 rad at 0.5 and 1 Hz: 1.6 and 3.1 rad/s.
    assert abs(only.healthy_high - 1.57) < 0.25  # the first samples of windows are no sine yet
    assert abs(only.high - 3.14) < 0.1
    # A sine is beyond 1.2 times half its amplitude for 59 % of the time.
    assert abs(only.share - 0.59) < 0.06
    assert "record healthy logs that go as far" in range_advice(start, problem, fit)[0]
    _, problem, fit = problem_of(swung(0.4, 0.4))
    assert range_advice(start, problem, fit) == ()


def test_a_wider_motion_names_the_angle_and_the_command():
    start = learned(swung(0.3, 0.5))
    _, problem, fit = problem_of(swung(0.9, 0.1))
    names = {b.name for b in beyond_healthy(start, problem, fit)}
    assert {SYSTEM.state_names[0], "goal"} <= names


def test_nothing_is_beyond_the_healthy_logs_where_there_are_none():
    start, problem, fit = problem_of(swung(0.3, 0.5))
    assert beyond_healthy(start, problem, fit) == []
