"""Detection of frozen sensors, and of working sensors that repeat values."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.logs.checks.frozen import frozen_stretches, summarised, without_frozen
from deepkoco.logs.recording import LogError, Recording, read_log, write_log
from deepkoco.logs.series import Series

PAIRS = [("theta", "omega")]


def swing(seed: int, noise: float = 1e-3, step: float = 0.0, rate: float = 100.0) -> dict[str, Series]:
    """Ten seconds of two sines that rest from 4 to 6 s, sampled with noise or rounded to steps."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 10.0, 1.0 / rate)
    clock = np.where(t < 4.0, t, np.where(t < 6.0, 4.0, t - 2.0))
    a, b = rng.uniform(0.5, 2.0, 2)
    theta = np.sin(a * (clock - 4.0) ** 2) + 0.5 * np.sin(b * (clock - 4.0) ** 2)
    omega = (
        2 * (clock - 4.0) * (a * np.cos(a * (clock - 4.0) ** 2) + 0.5 * b * np.cos(b * (clock - 4.0) ** 2))
    )
    theta = theta + noise * rng.standard_normal(len(t))
    omega = omega + 10.0 * noise * rng.standard_normal(len(t))
    if step:
        theta, omega = step * np.round(theta / step), 10 * step * np.round(omega / (10 * step))
    return {
        "theta": Series(t, theta, "rad", "measurement"),
        "omega": Series(t, omega, "rad/s", "measurement"),
    }


def freeze(series: Series, first: int, count: int) -> Series:
    value = series.value.copy()
    value[first : first + count] = value[first]
    return Series(series.t, value, series.unit, series.kind)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    name=st.sampled_from(["theta", "omega"]),
    first=st.one_of(st.integers(0, 250), st.integers(680, 850)),
    count=st.integers(30, 120),
    step=st.sampled_from([0.0, 1e-3]),
)
def test_frozen_stretches_find_channel_and_times(seed, name, first, count, step):
    channels = swing(seed, noise=0.0 if step else 1e-3, step=step)
    damaged = {**channels, name: freeze(channels[name], first, count)}
    found = frozen_stretches(damaged, PAIRS)
    assert [f.channel for f in found] == [name]
    # With rounding, the next sample can have the same value by chance.
    assert abs(found[0].start - 0.01 * first) < 0.035
    assert abs(found[0].stop - 0.01 * (first + count - 1)) < 0.035
    kept = without_frozen(damaged[name], found)
    assert len(kept) == len(damaged[name]) - (found[0].last - found[0].first)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    noise=st.sampled_from([0.0, 1e-4, 1e-2]),
    step=st.sampled_from([0.0, 1e-3, 2e-2]),
)
def test_frozen_stretches_ignore_a_joint_at_rest(seed, noise, step):
    assert frozen_stretches(swing(seed, noise, step), PAIRS) == []


def test_frozen_stretches_find_channels_that_freeze_together():
    channels = swing(3)
    found = frozen_stretches({n: freeze(s, 720, 90) for n, s in channels.items()}, PAIRS)
    assert [(f.channel, f.first, f.last) for f in found] == [("omega", 720, 809), ("theta", 720, 809)]


def test_frozen_stretches_find_a_single_angle_by_its_jump():
    theta = swing(0)["theta"]
    found = frozen_stretches({"theta": freeze(theta, 100, 60)}, [])
    assert [(f.first, f.last) for f in found] == [(100, 159)]


def test_frozen_stretches_ignore_missing_samples_that_were_filled():
    channels = swing(1)
    frozen = freeze(channels["theta"], 200, 60)
    t = frozen.t
    channels["theta"] = replace(frozen, unknown=np.array([[t[201], t[260]]]))
    assert frozen_stretches({**channels, "theta": frozen}, PAIRS)
    assert frozen_stretches(channels, PAIRS) == []


def test_frozen_stretches_ignore_constant_commands():
    channels = swing(1)
    torque = Series(np.arange(0, 10, 0.01), np.repeat([0.3, -0.2, 1.0, 0.0], 250), "N m", "command")
    assert frozen_stretches({**channels, "torque": torque}, PAIRS) == []


@pytest.mark.parametrize("name", ["theta", "omega"])
def test_read_log_warns_and_leaves_frozen_samples_out(tmp_path, name):
    channels = swing(2)
    t = channels["theta"].t
    channels["torque"] = Series(t, np.sin(3.0 * t), "N m", "command")
    channels[name] = freeze(channels[name], 700, 80)
    path = write_log(tmp_path / "log.csv", Recording(channels))
    log = read_log(path)
    assert log.unknown == ((7.0, 7.79),)
    assert any(
        f'"{name}" repeats one value from 7 to 7.79 s (80 samples)' in w and "checked: true" in w
        for w in log.warnings
    )
    assert len(log.channels[name]) == len(t) - 79
    text = path.with_suffix(".yaml").read_text()
    checked = text.replace(f"column: {name}\n", f"column: {name}\n    checked: true\n")
    assert checked != text
    path.with_suffix(".yaml").write_text(checked)
    assert read_log(path).unknown == ()


def motion(omega: np.ndarray, rate: float, steps: tuple[float, float]) -> dict[str, Series]:
    """Position and speed of a joint, rounded to the resolutions of an encoder and a tachometer."""
    t = np.arange(len(omega)) / rate
    theta = np.append(0.0, np.cumsum(0.5 * (omega[1:] + omega[:-1]) / rate))
    theta, omega = (step * np.round(value / step) for step, value in zip(steps, (theta, omega), strict=True))
    return {
        "theta": Series(t, theta, "rad", "measurement"),
        "omega": Series(t, omega, "rad/s", "measurement"),
    }


def driven(time_constant: float) -> np.ndarray:
    """20 s of a motor with the set speeds 0, 3, 0 and -3 rad/s in turn."""
    omega, told = np.zeros(2000), np.repeat([0.0, 3.0, 0.0, -3.0] * 5, 100)
    for k in range(1, 2000):
        omega[k] = told[k] + (omega[k - 1] - told[k]) * np.exp(-0.01 / time_constant)
    return omega


def knocked() -> np.ndarray:
    """Speed of a joint at rest that is hit three times."""
    t = np.arange(2000) / 100.0
    return np.sum(
        [2.0 * np.exp(-(t - at) / 0.5) * (t >= at) * ((t - at) < 4.0) for at in (3.0, 9.0, 15.0)], axis=0
    )


def decaying(rate: float = 100.0) -> np.ndarray:
    t = np.arange(int(30.0 * rate)) / rate
    return 2.0 * np.exp(-t / 8.0) * np.cos(4.0 * t)


def dead_band() -> np.ndarray:
    omega = decaying()
    return np.where(np.abs(omega) < 0.2, 0.0, omega)


@pytest.mark.parametrize(
    "channels",
    [
        motion(driven(0.01), 100.0, (1e-3, 1e-2)),
        motion(driven(0.02), 100.0, (1e-3, 1e-2)),
        motion(driven(0.02), 100.0, (2e-3, 5e-2)),
        motion(knocked(), 100.0, (1e-3, 1e-2)),
        motion(decaying(), 100.0, (1e-3, 1e-2)),
        {
            name: Series(np.arange(3000) / 100.0, np.repeat(series.value, 10), series.unit, series.kind)
            for name, series in motion(decaying(10.0), 10.0, (1e-6, 1e-6)).items()
        },
        {
            "theta": motion(decaying(), 100.0, (1e-4, 1e-2))["theta"],
            "omega": motion(dead_band(), 100.0, (1e-4, 1e-2))["omega"],
        },
    ],
    ids=[
        "motor 10 ms",
        "motor 20 ms",
        "motor, coarse",
        "knocks",
        "decay",
        "held readings",
        "dead band of the speed",
    ],
)
@pytest.mark.parametrize("alone", [False, True])
def test_frozen_stretches_ignore_repeated_values_of_working_sensors(channels, alone):
    if alone:
        assert all(frozen_stretches({name: series}, []) == [] for name, series in channels.items())
    else:
        assert frozen_stretches(channels, PAIRS) == []


def test_read_log_refuses_a_mostly_frozen_log(tmp_path):
    channels = swing(2)
    channels["torque"] = Series(channels["theta"].t, np.sin(3.0 * channels["theta"].t), "N m", "command")
    for first in (20, 600, 800):
        channels["theta"] = freeze(channels["theta"], first, 180)
    path = write_log(tmp_path / "log.csv", Recording(channels))
    with pytest.raises(LogError, match=r'"theta" repeats values in 5. % of its samples.*checked: true'):
        read_log(path)


def test_summarised_merges_many_stretches_into_one_warning():
    channels = swing(4)
    for first in range(0, 400, 80):
        channels["theta"] = freeze(channels["theta"], first, 40)
    found = frozen_stretches(channels, PAIRS)
    assert len(found) > 3
    assert len(summarised(found)) == 1
    assert f"in {len(found)} stretches" in summarised(found)[0]
