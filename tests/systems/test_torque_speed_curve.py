"""A drive whose force falls with speed: what it loses, and the speed at which nothing is left."""

import pytest
import torch

from deepkoco import Channel, Parameter, System
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.effects import effects_of
from deepkoco.systems.motion import Motion


def at(*values: float) -> tuple[torch.Tensor, ...]:
    return tuple(torch.tensor(v, dtype=torch.float64) for v in values)


def force(effort: float, speed: float, droop: float = 0.05) -> float:
    """What the motor of a pendulum delivers at its upright position [N m]."""
    system = ExtendedSystem(
        make_system("rod_pendulum"), ("torque_speed_curve",), {"torque_speed_curve.droop": droop}
    )
    p = system.default_parameters()
    law = system.accelerations(p)
    moved, coasts = (law(Motion(at(0.0), at(speed), at(u)))[0] for u in (effort, 0.0))
    one = law(Motion(at(0.0), at(0.0), at(1.0)))[0] - law(Motion(at(0.0), at(0.0), at(0.0)))[0]
    return float((moved - coasts) / one)


@pytest.mark.parametrize(
    ("effort", "speed", "delivered"),
    [
        (2.0, 4.0, 2.0 * (1.0 - 0.05 * 4.0)),
        (-2.0, -4.0, -2.0 * (1.0 - 0.05 * 4.0)),
        (2.0, -4.0, 2.0),  # it brakes
        (-2.0, 4.0, -2.0),
        (2.0, 0.0, 2.0),
        (2.0, 20.0, 0.0),  # no-load speed
        (2.0, 30.0, -1.0),  # driven beyond it
    ],
)
def test_a_drive_loses_force_with_the_speed_at_which_it_pushes(effort, speed, delivered):
    assert force(effort, speed) == pytest.approx(delivered, abs=1e-9)


def test_it_belongs_to_joints_that_are_driven():
    furuta = effects_of(make_system("furuta_pendulum"))
    assert [name for name in furuta if name.startswith("torque_speed_curve")] == [
        "torque_speed_curve(joint 1)"
    ]


def test_its_unit_is_one_over_the_no_load_speed_where_drives_deliver_loads():
    system = ExtendedSystem(make_system("servo_pendulum"), ("torque_speed_curve",))
    assert system.parameter("torque_speed_curve.droop").unit == "s/rad"


class Wheel(System):
    """A wheel of 1 kg m2 whose drive gives 4 N m at standstill for a duty of 1."""

    joint_units = ("rad",)
    parameters = (Parameter("strength", 4.0, "N m", 0.0, 10.0, 0.1, "torque of a duty of 1"),)
    commands = (Channel("duty", "1", "command", -1.0, 1.0),)
    measurements = (Channel("angle", "rad", "measurement", noise_sd=1e-3),)

    def accelerations(self, p):
        def law(motion):
            return (p["strength"] * motion.efforts[0] + motion.load(0),)

        return law


def test_a_drive_with_another_unit_than_its_load_is_left_without_force_at_the_standstill_load_over_the_droop():
    system = ExtendedSystem(Wheel(), ("torque_speed_curve",), {"torque_speed_curve.droop": 0.2})
    law = system.accelerations(system.default_parameters())
    assert system.parameter("torque_speed_curve.droop").unit != "s/rad"
    for effort in (0.3, 1.0):
        assert float(law(Motion(at(0.0), at(4.0 / 0.2), at(effort)))[0]) == pytest.approx(0.0, abs=1e-12)
