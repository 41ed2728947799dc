"""The servo pendulum by hand: its law, its switch, what its actuator delivers to friction."""

import pytest
import torch

from deepkoco.systems import ExtendedSystem, JointCountError, Motion, make_system, one_joint
from deepkoco.systems.effects import effects_of


def at(*values):
    return tuple(torch.tensor(v, dtype=torch.float64) for v in values)


def test_the_servo_pulls_towards_its_goal_while_it_is_on():
    system = make_system("servo_pendulum")
    p = system.default_parameters()
    law = system.accelerations(p)
    # At 0 with goal 0.2, standing: 10 * 0.2 / 0.011; switched off: nothing.
    assert float(law(Motion(at(0.0), at(0.0), at(0.2, 1.0)))[0]) == pytest.approx(2.0 / 0.011)
    assert float(law(Motion(at(0.0), at(0.0), at(0.2, 0.0)))[0]) == 0.0
    # Horizontal, off, at speed: weight and friction remain.
    expected = -(0.0574 + 0.03 * 2.0) / 0.011
    assert float(law(Motion(at(torch.pi / 2), at(2.0), at(0.0, 0.0)))[0]) == pytest.approx(expected)
    state, effort = torch.tensor([0.0, 0.0]), torch.tensor([0.2, 1.0])
    assert system.derivative(state, effort, p).tolist() == pytest.approx([0.0, 2.0 / 0.011])


def test_load_friction_follows_the_torque_of_the_servo():
    system = ExtendedSystem(
        make_system("servo_pendulum"), ("load_friction",), {"load_friction.coefficient": 0.1}
    )
    p = system.default_parameters()
    motion = Motion(at(0.0), at(5.0), at(0.5, 1.0))
    with_friction, without = (s.accelerations(p)(motion)[0] for s in (system, system.base))
    torque = 10.0 * 0.5 - 0.3 * 5.0
    assert float(without - with_friction) == pytest.approx(0.1 * torque / 0.011, rel=1e-9)
    assert system.parameter("load_friction.coefficient").unit == "N m/(N m)"


def test_the_switch_has_no_effects_of_its_own():
    names = set(effects_of(make_system("servo_pendulum")))
    assert {"gain", "actuation_delay", "payload", "coulomb", "tilt"} <= names
    assert not {n for n in names if "enable" in n or "joint" in n}


def test_what_needs_a_bare_torque_refuses_it():
    with pytest.raises(
        JointCountError, match="servo_pendulum has a joint behind a servo; this takes one that"
    ):
        one_joint("servo_pendulum")


def test_its_picture_hangs_at_zero():
    picture = make_system("servo_pendulum").draw([0.0, 0.0], [0.0, 1.0], 64)
    background = picture[0, 0].astype(int)
    assert (abs(picture[44:] - background) > 30).any()
    assert not (abs(picture[:24] - background) > 30).any()


def test_payload_may_be_several_times_what_a_short_arm_carries():
    # The bound counts in metres of an unknown arm; 3 cm is a short one.
    system = ExtendedSystem(make_system("servo_pendulum"), ("payload",))
    most = system.parameter("payload.mass").high
    assert most * 9.81 * 0.03 >= 2.9 * system.base.load_scale
