# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""Roll axis of a quadrotor on a test stand."""

import torch

from deepkoco import Channel, Parameter, System


class Roll(System):
    """Throttles of the two sides in; the gyro out."""

    joint_names = ("roll",)
    joint_units = ("rad",)
    parameters = (
        Parameter("inertia", 0.012, "kg m2", 1e-3, 0.1, 5e-4, "about the axis"),
        Parameter("thrust", 9.0, "N", 1.0, 50.0, 0.4, "of one side at full throttle"),
        Parameter("weight", 0.35, "N m", 0.0, 5.0, 0.03, "m g d; the centre of mass is below the axis"),
        Parameter("viscous", 0.01, "N m s/rad", 0.0, 0.2, 0.005, "bearings and air"),
    )
    commands = (
        Channel("throttle_left", "1", "command", 0.0, 1.0),
        Channel("throttle_right", "1", "command", 0.0, 1.0),
    )
    measurements = (Channel("gyro", "rad/s", "measurement", noise_sd=0.006),)
    measured_states = (1,)
    command_joints = (0, 0)

    def ideal_measurement(self, state):
        return state[..., [1]]

    def accelerations(self, p):
        def law(s):
            left, right = s.efforts[0], s.efforts[1]
            lift = 0.15 * p["thrust"] * (left**2 - right**2)
            t = lift - p["weight"] * torch.sin(s.angles[0]) - p["viscous"] * s.speeds[0] + s.load(0)
            return (t / p["inertia"],)

        return law
