# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""Pitch drive of a blade of a wind turbine: a motor with a speed controller turns the blade in its bearing."""

import torch

from deepkoco import Channel, Parameter, System


class PitchDrive(System):
    """Wanted speed of the blade in, its angle out. The rotor stands and the blade points aside."""

    joint_names = ("blade",)
    joint_units = ("rad",)
    parameters = (
        Parameter(
            "inertia", 900.0, "kg m2", 100.0, 1e4, 40.0, "blade and geared motor, about the pitch axis"
        ),
        Parameter("control", 6000.0, "N m s/rad", 200.0, 1e5, 500.0, "of the speed controller"),
        Parameter("viscous", 700.0, "N m s/rad", 0.0, 1e4, 200.0, "grease of bearing and gear"),
        Parameter("bearing", 220.0, "N m", 0.0, 5000.0, 60.0, "dry friction of the bearing"),
        Parameter(
            "weight", 350.0, "N m", -5000.0, 5000.0, 60.0, "the blade bends: its mass is beside the axis"
        ),
    )
    commands = (Channel("wanted", "rad/s", "command", -0.3, 0.3),)
    measurements = (Channel("pitch", "rad", "measurement", noise_sd=2e-4, angle=True),)

    def dry_friction_limits(self, p):
        return (p["bearing"],)

    def accelerations(self, p):
        def law(s):
            w = s.speeds[0]
            moment = p["control"] * (s.efforts[0] - w) - p["viscous"] * w
            moment = moment - p["weight"] * torch.cos(s.angles[0])
            return ((moment - p["bearing"] * s.direction(0, over=1e-3) + s.load(0)) / p["inertia"],)

        return law
