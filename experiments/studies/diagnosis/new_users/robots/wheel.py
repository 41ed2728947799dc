# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A pendulum with a reaction wheel, of which the speed is logged and not the angle."""

import torch

from deepkoco import Channel, Parameter, System


class Wheel(System):
    """Current of the motor between body and wheel."""

    joint_names = ("body", "wheel")
    joint_units = ("rad", "rad")
    parameters = (
        Parameter(
            "body_inertia", 0.012, "kg m2", 1e-3, 0.1, 5e-4, "about the pivot, with the mass of the wheel"
        ),
        Parameter("wheel_inertia", 6e-4, "kg m2", 5e-5, 5e-3, 2e-5, "about its own axis"),
        Parameter("weight", 0.9, "N m/rad", 0.05, 5.0, 0.03, "m g l"),
        Parameter("constant", 0.035, "N m/A", 0.005, 0.3, 0.001, "of the motor"),
        Parameter("body_viscous", 1e-3, "N m s/rad", 0.0, 0.05, 5e-4, "pivot"),
        Parameter("wheel_viscous", 5e-5, "N m s/rad", 0.0, 0.01, 3e-5, "bearing of the wheel"),
    )
    commands = (Channel("current", "A", "command", -6.0, 6.0),)
    measurements = (
        Channel("tilt", "rad", "measurement", noise_sd=1e-3, angle=True),
        Channel("wheel_speed", "rad/s", "measurement", noise_sd=0.3),
    )
    measured_states = (0, 3)

    def ideal_measurement(self, state):
        return state[..., [0, 3]]

    def accelerations(self, p):
        def law(s):
            a, (w, r) = s.angles[0], s.speeds
            t = (
                p["constant"] * s.efforts[0] - p["wheel_viscous"] * r + s.load(1)
            )  # on the wheel, from the body
            b = (-p["weight"] * torch.sin(a) - p["body_viscous"] * w - t + s.load(0)) / p["body_inertia"]
            return b, t / p["wheel_inertia"] - b

        return law
