# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""Pitch axis of a camera gimbal on its stand."""

import torch

from deepkoco import Channel, Parameter, System


class Gimbal(System):
    """Command of the motor driver in; encoder of the axis and gyro of the camera out."""

    joint_names = ("pitch",)
    joint_units = ("rad",)
    parameters = (
        Parameter("inertia", 2.2e-3, "kg m2", 2e-4, 0.05, 1e-4, "camera and frame"),
        Parameter("torque", 0.35, "N m", 0.02, 5.0, 0.02, "of the motor at full command"),
        Parameter("unbalance", 0.02, "N m", -0.2, 0.2, 0.01, "m g d, the camera hangs a little low"),
        Parameter("viscous", 4e-3, "N m s/rad", 0.0, 0.05, 1.5e-3, "bearings and the motor's eddy currents"),
    )
    commands = (Channel("drive", "1", "command", -1.0, 1.0),)
    measurements = (
        Channel("encoder", "rad", "measurement", noise_sd=2e-4, angle=True),
        Channel("gyro", "rad/s", "measurement", noise_sd=2e-3, zero_sd=0.01),
    )

    def accelerations(self, p):
        def law(s):
            t = p["torque"] * s.efforts[0] - p["unbalance"] * torch.sin(s.angles[0])
            return ((t - p["viscous"] * s.speeds[0] + s.load(0)) / p["inertia"],)

        return law
