"""Recordings of a unit, in either clock."""

import math

import numpy as np
import pytest

from deepkoco.excitation.record import RecordError, record
from deepkoco.logs.inspect.log_summary import summarise
from deepkoco.logs.recording import read_log, write_log
from deepkoco.unit import UnitError, UnitSpec, make_unit
from deepkoco.unit.plant import Plant


def noise_free(**effects) -> UnitSpec:
    return make_unit("rod_pendulum", effects=effects, sensor={"noise_sd": {"theta": 0.0, "omega": 0.0}})


def replay(spec: UnitSpec, recording) -> np.ndarray:
    """Angle at the measurements' stamps under the logged commands, by the unit without its delays."""
    plant, angles = Plant(spec), []
    torque = recording.channels["torque"]
    events = [(t, 0, value) for t, value in zip(torque.t, torque.value, strict=True)]
    events += [(t, 1, 0.0) for t in recording.channels["theta"].t]
    for t, is_sample, value in sorted(events):
        plant.advance(float(t))
        if is_sample:
            angles.append(plant.joint.theta)
        else:
            plant.send(float(value))
    return np.array(angles)


def test_simulated_log_is_exact():
    spec = noise_free(coulomb={"torque": 0.1})
    recording = record(spec, "chirp", 5.0, clock="simulated")
    theta, torque = recording.channels["theta"], recording.channels["torque"]
    assert theta.t == pytest.approx(np.arange(501) / 100.0)
    assert torque.t == pytest.approx(np.arange(251) / 50.0)
    assert torque.value[0] == 0.0
    assert replay(spec, recording) == pytest.approx(theta.value, abs=1e-9)


def test_same_seed_same_bytes(tmp_path):
    law = {"delay": {"mean": 0.02, "sd": 0.01}}
    spec = make_unit("pendulum", effects={"sensing_delay": law, "actuation_delay": law}, seed=5)
    files = []
    for name in ("a.csv", "b.csv"):
        path = write_log(tmp_path / name, record(spec, "steps", 4.0, clock="simulated", seed=2))
        files.append((path.read_bytes(), path.with_suffix(".yaml").read_bytes()))
    assert files[0] == files[1]


def test_log_reads_back_bit_for_bit(tmp_path):
    recording = record(make_unit("torque_pendulum"), "prbs", 3.0, clock="simulated", meta={"note": "x"})
    back = read_log(write_log(tmp_path / "log.csv", recording), system="torque_pendulum")
    assert back.meta == recording.meta
    for name, series in recording.channels.items():
        assert np.array_equal(back.channels[name].t, series.t)
        assert np.array_equal(back.channels[name].value, series.value)
        assert (back.channels[name].unit, back.channels[name].kind) == (series.unit, series.kind)


def test_sensing_delay_shows_as_old_measurements():
    delayed = record(
        noise_free(sensing_delay={"delay": 0.04}), lambda t, m: math.sin(3 * t), 3.0, clock="simulated"
    )
    theta = delayed.channels["theta"]
    assert theta.t[0] == pytest.approx(0.04)
    true = replay(noise_free(), delayed)
    # stamps are 4 samples late: reading k is the angle that held 4 samples before
    assert theta.value[4:] == pytest.approx(true[:-4], abs=2e-3)
    assert np.abs(theta.value[4:] - true[4:]).max() > 0.02


def test_closed_loop_policy_sees_what_is_logged():
    seen = []

    def policy(t, measurement):
        seen.append((t, measurement[0]))
        return 0.0

    recording = record(make_unit("rod_pendulum"), policy, 1.0, clock="simulated", control_rate=20.0)
    theta = recording.channels["theta"]
    rows = dict(zip(theta.t, theta.value, strict=True))
    assert seen
    assert all(rows[t] == value for t, value in seen)
    assert [t for t, _ in seen] == pytest.approx(np.arange(1, 21) / 20.0)


def test_wall_clock_log_fits_the_unit_that_made_it():
    spec = noise_free(coulomb={"torque": 0.15})
    recording = record(spec, "steps", 2.0)
    theta = recording.channels["theta"]
    assert len(theta) > 100
    assert np.all(np.diff(theta.t) > 0)
    assert recording.meta["clock"] == "wall"
    median = float(np.median(np.abs(replay(spec, recording) - theta.value)))
    frictionless = float(np.median(np.abs(replay(noise_free(), recording) - theta.value)))
    assert median < 0.02
    assert frictionless > 3.0 * median


def test_log_made_through_a_stop_is_refused():
    spec = make_unit("rod_pendulum", heartbeat=0.021)
    slow = record(spec, "steps", 1.0, clock="simulated", control_rate=50.0)
    assert slow.meta["samples_lost"] == 0
    late = make_unit(
        "rod_pendulum", heartbeat=0.06, effects={"sensing_delay": {"delay": {"mean": 0.15, "sd": 0.1}}}
    )
    with pytest.raises(UnitError, match=r"stopped itself .* heartbeat"):
        record(late, "steps", 5.0, clock="simulated")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"clock": "sundial"}, 'unknown clock "sundial"; known: wall, simulated'),
        ({"control_rate": 500.0}, r"control rate 500 Hz .* at most 100 Hz \(its sensor\)"),
        ({"control_rate": 1.0}, r"more than 2 Hz \(its heartbeat\)"),
        ({"seconds": -1.0}, "seconds: -1 s is not the length"),
        ({"seconds": math.nan}, "seconds: nan s is not the length"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(RecordError, match=message):
        record(make_unit("rod_pendulum"), "chirp", **{"seconds": 1.0, **options})


def test_summary_of_a_simulated_log():
    recording = record(make_unit("rod_pendulum"), "prbs", 2.0, clock="simulated")
    summary = {s.name: s for s in summarise(recording)}
    assert summary["theta"].rate_hz == pytest.approx(100.0)
    assert summary["theta"].gaps == 0
    assert summary["theta"].jitter_s == pytest.approx(0.0, abs=1e-12)
    assert (summary["torque"].low, summary["torque"].high) == (-2.0, 2.0)


def test_an_excitation_that_gives_nan_is_named_with_its_time():
    with pytest.raises(RecordError, match=r"the excitation gives the command nan at 0\.500 s"):
        record(noise_free(), lambda t, _: 0.1 if t < 0.49 else math.nan, 2.0, clock="simulated")
