"""Causes hidden by the independent generator in units of every system: named in class; controls stay silent."""

import numpy as np
import pytest

from deepkoco.diagnose import CAUSES, diagnose
from deepkoco.diagnose.causes import catalogue, is_changed, kind_of, measured_channels, shown_causes
from deepkoco.systems import make_system
from deepkoco.systems.effects import effects_of
from tests.oracle.unit import hidden_log
from tests.studied import studied

SECONDS = 20.0
# cause -> (system, excitation, what is hidden)
HIDDEN = {
    "clock_skew": ("rod_pendulum", "steps", {"rate": 1e-3}),
    "jitter": ("rod_pendulum", "steps", {"sd": 0.003}),
    "load_friction": ("rod_pendulum", "steps", {"coefficient": 0.05}),
    "backlash": ("rod_pendulum", "steps", {"width": 0.1}),
    "gain_drift": ("rod_pendulum", "steps", {"rate": 0.01}),
    "asymmetry": ("rod_pendulum", "steps", {"share": 0.05}),
    "cogging": ("rod_pendulum", "steps", {"sine": 0.1, "cosine": 0.05, "cycles": 7.0}),
    "periodic": ("rod_pendulum", "steps", {"sine": 0.1, "cosine": 0.0, "frequency": 9.0}),
    "length": ("rod_pendulum", "steps", {"factor": 1.05}),
    "tilt": ("rod_pendulum", "steps", {"angle": 0.02}),
    "sensor_drift": ("rod_pendulum", "steps", {"rate": 0.002}),
    "low_pass": ("rod_pendulum", "steps", {"time_constant": 0.03}),
    "noise_level(omega)": ("rod_pendulum", "steps", {"factor": 4.0}),
    "quantisation(theta)": ("rod_pendulum", "steps", {"step": 0.02}),
    "unit_slip": ("rod_pendulum", "steps", {"factor": 1e-3}),
    "channel_slip(theta)": ("rod_pendulum", "steps", {"factor": 180.0 / np.pi}),
    "coulomb(joint 2)": ("two_link_arm", "steps", {"torque": 0.1}),
    "gain(joint 1)": ("two_link_arm", "chirp", {"factor": 0.9}),
    "payload": ("quadrotor_height", "steps", {"mass": 0.003}),
    "actuation_delay": ("quadrotor_height", "closed-loop", {"delay": 0.02}),
    "lost_commands": ("rod_pendulum", "chirp", {"share": 0.05}),
    "gain_curve": ("rod_pendulum", "chirp", {"curvature": -0.015}),
    "torque_speed_curve": ("rod_pendulum", "steps", {"droop": 0.05}),
    "asymmetric_viscous(joint 1)": ("two_link_arm", "steps", {"difference": 0.4}),
    "sensor_ripple(joint 1)": ("two_link_arm", "steps", {"sine": 0.01, "cosine": -0.006, "cycles": 1.0}),
    "sensor_shift(joint 2)": ("two_link_arm", "steps", {"angle": 0.03, "start": 11.2, "duration": 0.004}),
}


def test_every_cause_has_an_effect_or_a_parameter_or_is_an_event():
    for system in ("rod_pendulum", "two_link_arm", "quadrotor_height"):
        base = make_system(system)
        known = effects_of(base)
        for name, cause in catalogue(base).items():
            assert kind_of(name) in CAUSES
            if is_changed(cause):
                assert name == f"changed({cause.free[0]})"
                assert base.parameter(cause.free[0])
                continue
            assert cause.effect == "event" or cause.effect in known
            declared = (
                {f"{cause.effect}.{p.name}" for p in known[name].parameters(base)} if name in known else set()
            )
            assert cause.effect == "event" or set(cause.free) <= declared


@pytest.mark.parametrize("cause", studied(HIDDEN, (), ("lost_commands", "gain(joint 1)")))
def test_diagnose_names_the_class_of_each_hidden_cause(cause):
    system, excitation, values = HIDDEN[cause]
    log = hidden_log(system, {cause: values}, excitation, 120 + list(HIDDEN).index(cause), SECONDS)
    result = diagnose([log], system)
    assert result.verdict in ("cause", "ambiguous")
    assert cause in result.causes[0].members
    if cause == "jitter":  # no simulation takes it away, so its size is what shows that it was understood
        assert result.causes[0].parameters["jitter.sd"].value == pytest.approx(values["sd"], rel=0.1)
    else:
        assert result.chi2_after < 1.15


@pytest.mark.study
@pytest.mark.parametrize(
    ("system", "excitation"),
    [("two_link_arm", "steps"), ("quadrotor_height", "closed-loop"), ("pendulum", "closed-loop")],
)
def test_diagnose_names_nothing_on_a_control_of_the_generator(system, excitation):
    result = diagnose([hidden_log(system, {}, excitation, 150, SECONDS)], system)
    assert result.verdict == "nothing"
    assert result.causes == ()


def test_logs_show_only_the_causes_of_channels_that_they_measure():
    known = catalogue(make_system("rod_pendulum"))
    both = {c.name for c in shown_causes(known, {"theta", "omega"})}
    one = {c.name for c in shown_causes(known, {"theta"})}
    assert both == set(known)
    # A late channel is told from late measurements by the others, a scaled one by the joint's other sensor.
    of_omega = {name for name in both if name.endswith("(omega)")}
    assert "noise_level(omega)" in of_omega
    assert both - one == of_omega | {"channel_delay(theta)", "channel_scale(theta)"}
    log = hidden_log("rod_pendulum", {}, "steps", 0, seconds=2.0)
    assert measured_channels([log]) == {"theta", "omega"}


def test_logs_show_a_delay_of_all_speeds_beside_a_position_and_from_two_speeds_on():
    system = make_system("two_link_arm")
    known = catalogue(system)
    angles = [c.name for c in system.measurements if c.unit == "rad"]
    speeds = [c.name for c in system.measurements if c.unit == "rad/s"]

    def shown(*channels):
        return "speed_delay" in {c.name for c in shown_causes(known, channels)}

    assert shown(angles[0], *speeds)
    assert not shown(*angles, speeds[0])
    assert not shown(*speeds)
