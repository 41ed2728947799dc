"""A channel whose readings are older than those of the other one, on closed-form motion."""

import math

import numpy as np
import pytest
import torch

from deepkoco import Channel, Parameter, System
from deepkoco.fit import cut_windows, fit
from deepkoco.fit.simulate.simulator import predict
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.effects import effects_of
from tests.oracle.unit import hidden_log


class Tray(System):
    """One joint and one sensor."""

    joint_units = "m"
    parameters = (Parameter("mass", 1.0, "kg", 0.1, 10.0, 0.1, "m"),)
    commands = (Channel("push", "N", "command", -1.0, 1.0),)
    measurements = (Channel("way", "m", "measurement", noise_sd=1e-3),)

    def accelerations(self, p):
        return lambda motion: ((motion.efforts[0] + motion.load(0)) / p["mass"],)


RATE = math.sqrt(15.0)  # of the rod pendulum's small motion [rad/s]


def swing(late: dict[str, float], amplitude: float = 0.02, seconds: float = 10.0, seed: int = 0) -> Recording:
    """Free small swings about hanging; readings of a channel are ``late`` seconds old."""
    t = np.arange(int(seconds * 100.0)) / 100.0
    phase = {name: RATE * (t - late.get(name, 0.0)) for name in ("theta", "omega")}
    rng = np.random.default_rng(seed)
    theta = math.pi + amplitude * np.cos(phase["theta"]) + 2e-5 * rng.standard_normal(len(t))
    omega = -amplitude * RATE * np.sin(phase["omega"]) + 1e-4 * rng.standard_normal(len(t))
    return Recording(
        {
            "torque": Series(t, np.zeros(len(t)), "N m", "command"),
            "theta": Series(t, theta, "rad", "measurement"),
            "omega": Series(t, omega, "rad/s", "measurement"),
        },
        system="rod_pendulum",
    )


@pytest.mark.parametrize(("channel", "delay"), [("theta", 0.04), ("omega", 0.13), ("theta", 0.0)])
def test_a_fit_finds_how_much_older_one_channel_is(channel, delay):
    parameter = f"channel_delay({channel}).delay"
    found = fit([swing({channel: delay})], "rod_pendulum", [parameter], window=1.0)
    assert found.estimates[parameter].value == pytest.approx(delay, abs=5e-4)


def test_both_channels_late_by_the_same_time_are_one_delay_of_the_sensors():
    base = make_system("rod_pendulum")
    names = ("channel_delay(theta)", "channel_delay(omega)")
    both = ExtendedSystem(base, names, {f"{n}.delay": 0.03 for n in names})
    sensors = ExtendedSystem(base, ("sensing_delay",), {"sensing_delay.delay": 0.03})
    delays = [float(s.command_timing(0, s.default_parameters()).delay) for s in (both, sensors)]
    assert delays == pytest.approx([0.03, 0.03])


def test_the_command_is_late_for_the_state_that_the_latest_channel_shows():
    base = make_system("rod_pendulum")
    system = ExtendedSystem(base, ("channel_delay(theta)", "actuation_delay"))
    p = system.default_parameters()
    p |= {"channel_delay(theta).delay": torch.tensor(0.05), "actuation_delay.delay": torch.tensor(0.02)}
    assert float(system.command_timing(0, p).delay) == pytest.approx(0.07)


def test_a_system_with_one_channel_has_no_delay_of_a_channel_of_its_own():
    assert "channel_delay(theta)" in effects_of(make_system("rod_pendulum"))
    assert not [n for n in effects_of(Tray()) if n.startswith("channel_delay")]


def test_a_delay_of_all_speeds_is_the_same_delay_of_each_of_them():
    base = make_system("two_link_arm")
    speeds = [c.name for c in base.measurements if c.unit == "rad/s"]
    names = ("speed_delay",), tuple(f"channel_delay({c})" for c in speeds)
    common, apart = (ExtendedSystem(base, n, {f"{x}.delay": 0.02 for x in n}) for n in names)
    ours, theirs = (s.channel_delays(s.default_parameters()) for s in (common, apart))
    assert {base.measurements[c].name for c in ours} == set(speeds)
    assert {c: float(x) for c, x in ours.items()} == {c: float(x) for c, x in theirs.items()}
    ours, theirs = (float(s.command_timing(1, s.default_parameters()).delay) for s in (common, apart))
    assert ours == theirs == pytest.approx(0.02)


def test_a_late_channel_is_later_still_where_all_speeds_are_late():
    base = make_system("two_link_arm")
    index, one = next((c, m.name) for c, m in enumerate(base.measurements) if m.unit == "rad/s")
    names = ("speed_delay", f"channel_delay({one})")
    both = ExtendedSystem(base, names, {"speed_delay.delay": 0.02, f"channel_delay({one}).delay": 0.01})
    p = both.default_parameters()
    assert float(both.channel_delays(p)[index]) == pytest.approx(0.03)
    assert float(both.command_timing(0, p).delay) == pytest.approx(0.03)


def test_one_speed_has_no_delay_of_all_speeds():
    assert "speed_delay" in effects_of(make_system("two_link_arm"))
    assert "speed_delay" not in effects_of(make_system("rod_pendulum"))
    assert "speed_delay" not in effects_of(Tray())


def test_speeds_that_are_late_together_are_shown_as_if_each_were_late():
    base = make_system("two_link_arm")
    windows = cut_windows([hidden_log("two_link_arm", {}, "steps", 4, 4.0)], base, 1.0)
    speeds = [c.name for c in base.measurements if c.unit == "rad/s"]
    shown = []
    for names in (("speed_delay",), tuple(f"channel_delay({c})" for c in speeds)):
        system = ExtendedSystem(base, names, {f"{n}.delay": 0.02 for n in names})
        values = {n: v.reshape(1) for n, v in system.default_parameters().items()}
        shown.append(predict(system, windows, values, windows.state[None]))
    assert torch.equal(*shown)
    prompt = predict(
        base, windows, {n: v.reshape(1) for n, v in base.default_parameters().items()}, windows.state[None]
    )
    late = [k >= base.joints for k in base.measured_states]
    # The window begins at the state that the late channels show, so the positions are ahead by the delay.
    assert not torch.allclose(
        shown[0][:, :, [not x for x in late]], prompt[:, :, [not x for x in late]], atol=1e-4
    )
