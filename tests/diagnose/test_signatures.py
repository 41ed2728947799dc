"""Signatures of sensors and clocks in the residuals."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.residuals.signatures import signatures
from deepkoco.fit import cut_windows, moving
from deepkoco.logs.recording import Recording
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

SYSTEM = make_system("rod_pendulum")


def told(recording: Recording) -> dict[str, float]:
    """Kinds of the signatures that the refitted baseline leaves, each with its statistic over its threshold."""
    windows = cut_windows([recording], SYSTEM, 1.6)
    windows, fit = refit_sharply(baseline_from(SYSTEM, windows), windows.take(moving(windows)))
    return {e.kind: e.statistic / e.threshold for e in signatures(SYSTEM, windows, fit)}


def unit(hidden: dict, excitation: str = "steps") -> Recording:
    return hidden_log("rod_pendulum", hidden, excitation, 11, 12.0)


@pytest.mark.parametrize("excitation", ["steps", "chirp", "closed-loop"])
def test_signatures_are_empty_for_a_healthy_unit(excitation):
    assert told(unit({}, excitation)) == {}


def test_scattered_stamps_are_found_for_jitter():
    found = told(unit({"jitter": {"sd": 0.003}}))
    assert set(found) == {"scattered_stamps"}
    assert found["scattered_stamps"] > 1.0


def test_stamps_that_were_moved_to_even_times_are_told_with_their_scatter():
    log = unit({})
    late = np.random.default_rng(5).normal(0.0, 4e-4, len(log.channels["theta"]))
    scattered = {
        name: replace(series, t=series.t + late) if len(series) == len(late) and name != "torque" else series
        for name, series in log.channels.items()
    }
    windows = cut_windows([replace(log, channels=scattered)], SYSTEM, 1.6)
    assert windows.taken_out == pytest.approx((4e-4,) * len(SYSTEM.measurements), rel=0.05)
    found = told(replace(log, channels=scattered))
    assert set(found) == {"moved_stamps"}
    assert found["moved_stamps"] == pytest.approx(4.0, rel=0.05)
    assert cut_windows([log], SYSTEM, 1.6).taken_out == ()


def test_value_grid_reports_its_step():
    assert told(unit({"quantisation(theta)": {"step": 0.01}})) == {"value_grid": pytest.approx(3.0, rel=0.3)}
    assert told(unit({"quantisation(theta)": {"step": 0.0005}})) == {}


def test_repeated_readings_are_found():
    log = unit({})
    theta, rng = log.channels["theta"], np.random.default_rng(2)
    value = theta.value.copy()
    for k in np.flatnonzero(rng.random(len(value)) < 0.03):
        value[k] = value[max(k - 1, 0)]
    found = told(replace(log, channels={**log.channels, "theta": replace(theta, value=value)}))
    assert 4.0 < found["repeated_readings"] < 8.0


@pytest.mark.parametrize("excitation", ["steps", "chirp"])
def test_scattered_stamps_are_not_reported_for_a_slow_sensor(excitation):
    log = unit({}, excitation)
    held = {}
    for name, series in log.channels.items():
        at = np.arange(len(series)) // 2 * 2
        held[name] = replace(series, value=series.value[at]) if series.kind == "measurement" else series
    assert set(told(replace(log, channels=held))) == {"repeated_readings"}


def test_scattered_stamps_are_not_reported_for_a_wrong_model():
    assert told(unit({"gain_curve": {"curvature": -0.075}}, "chirp")) == {}
