"""A zero of a position sensor that moves once: its starts in closed form, and the cause that is named."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.residuals.shifts import shifts_of_zero
from deepkoco.fit.data.resolved import resolved
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import ExtendedSystem, make_system
from experiments.studies.diagnosis.hidden.recorded import unit_log

SYSTEM = make_system("rod_pendulum")
EXTENDED = ExtendedSystem(SYSTEM, ("sensor_shift",))


@pytest.fixture(scope="module")
def log():
    return unit_log("rod_pendulum", {}, "steps", 5, 12.0)


@pytest.fixture(scope="module")
def problem(log):
    return FitProblem(EXTENDED, cut_windows([log], SYSTEM, 1.0))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_best_start_is_the_best_of_all_least_squares_fits(problem, seed):
    windows, rng = problem.windows, np.random.default_rng(seed)
    count, size, samples = windows.value.shape
    own = torch.from_numpy(rng.standard_normal((count, size * samples, 2)))
    basis, _ = torch.linalg.qr(own * problem.weight.reshape(count, -1, 1))
    residual = torch.from_numpy(rng.standard_normal((count, size * samples, 1)))
    residual = (residual - basis @ (basis.mT @ residual)) * (problem.weight.reshape(count, -1, 1) > 0.0)
    best, *_ = shifts_of_zero(problem, 0, residual, basis)
    falls = {}
    for w in range(count):
        for k in range(0, samples, 7):
            step = torch.zeros_like(windows.value)
            step[windows.t0 > windows.t0[w], 0] = 1.0
            step[w, 0, k:] = 1.0
            moved = (step * problem.weight).reshape(count, -1, 1)
            moved = (moved - basis @ (basis.mT @ moved)).reshape(-1).numpy()
            match, energy = moved @ residual.reshape(-1).numpy(), moved @ moved
            if bool(windows.valid[w, 0, k]) and energy > 1.0:
                time = float(windows.t0[w] + windows.t[w, 0, k])
                falls[time] = (match**2 / energy, match / energy)
    most = max(fall for fall, _ in falls.values())
    at = best["start"] + 1.5 * 0.5 * best["duration"] + float(windows.commands[0].t[0])
    nearest = min(falls, key=lambda t: abs(t - at))
    if abs(nearest - at) < 1e-6:  # one of those that were tried
        assert falls[nearest][0] == pytest.approx(most, rel=1e-9)
        assert best["angle"] == pytest.approx(falls[nearest][1], rel=1e-9)
    step = torch.zeros_like(windows.value)
    for w in range(count):
        times = windows.t0[w] + windows.t[w, 0].numpy()
        step[w, 0] = torch.from_numpy((times > at - 1e-6).astype(float))
    moved = (step * problem.weight).reshape(count, -1, 1)
    moved = (moved - basis @ (basis.mT @ moved)).reshape(-1).numpy()
    fall = (moved @ residual.reshape(-1).numpy()) ** 2 / (moved @ moved)
    assert fall >= most * (1.0 - 1e-9)


def test_two_logs_have_no_common_time_at_which_a_zero_moves(log):
    problem = FitProblem(EXTENDED, cut_windows([log, log], SYSTEM, 1.0))
    count = len(problem.windows)
    left = torch.from_numpy(
        np.random.default_rng(0).standard_normal((count, problem.windows.value[0].numel(), 1))
    )
    none = torch.zeros(*left.shape[:2], 0, dtype=torch.float64)
    assert shifts_of_zero(problem, 0, left, none) == ()
    one = FitProblem(EXTENDED, problem.windows.take(problem.windows.log == 0))
    own = int((problem.windows.log == 0).sum())
    assert shifts_of_zero(one, 0, left[:own], none[:own])


def test_a_zero_moves_no_faster_than_samples_show_and_within_the_log(problem, log):
    bounds = resolved(EXTENDED, problem.windows)
    stamps = log.channels["theta"].t
    assert bounds["sensor_shift.duration"].low == pytest.approx(float(np.median(np.diff(stamps))), rel=0.05)
    command = log.channels["torque"].t
    assert bounds["sensor_shift.start"].high == pytest.approx(command[-1] - command[0])
    assert problem.low[problem.names.index("sensor_shift.duration")] == bounds["sensor_shift.duration"].low


def test_an_encoder_that_slips_is_named_with_its_angle_and_its_time(log):
    theta = log.channels["theta"]
    value = np.array(theta.value, copy=True)
    value[theta.t > 7.483] += 0.04
    slipped = replace(log, channels={**log.channels, "theta": replace(theta, value=value)})
    found = diagnose(
        [slipped], "rod_pendulum", only=["sensor_shift", "sensor_drift", "sensor_bias", "event", "coulomb"]
    )
    assert found.names == ("sensor_shift",)
    (cause,) = found.causes
    assert cause.parameters["sensor_shift.angle"].value == pytest.approx(0.04, rel=0.03)
    start, lasts = (cause.parameters[f"sensor_shift.{n}"].value for n in ("start", "duration"))
    assert start - 0.01 <= 7.483 <= start + lasts + 0.01
