# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A camera on two bus servos: pan about the vertical, tilt above it."""

import torch

from deepkoco import Channel, Parameter, System


class PanTilt(System):
    """Goals of both servos in; their positions out. Tilt is 0 where the camera looks ahead."""

    joint_names = ("pan", "tilt")
    joint_units = ("rad", "rad")
    parameters = (
        Parameter("base", 1.2e-3, "kg m2", 1e-4, 0.1, 1e-4, "bracket and servo about the vertical"),
        Parameter("camera", 0.35, "kg", 0.05, 3.0, 0.01, "camera and lens"),
        Parameter("centre", 0.045, "m", 0.0, 0.3, 0.002, "of its mass, in front of the tilt axis"),
        Parameter("rotor", 1.5e-3, "kg m2", 1e-4, 0.05, 1e-4, "tilt servo and camera about its own centre"),
        Parameter("kp", 4.5, "N m/rad", 0.5, 50.0, 0.3, "stiffness of a servo's loop"),
        Parameter("kd", 0.12, "N m s/rad", 0.0, 5.0, 0.015, "damping of a servo's loop"),
        Parameter("friction", 0.02, "N m", 0.0, 1.0, 0.006, "dry friction of a servo"),
    )
    commands = (
        Channel("goal_pan", "rad", "command", -3.2, 3.2),
        Channel("goal_tilt", "rad", "command", -1.6, 1.6),
    )
    measurements = (
        Channel("pan", "rad", "measurement", noise_sd=5e-4, angle=True),
        Channel("tilt", "rad", "measurement", noise_sd=5e-4, angle=True),
    )

    def dry_friction_limits(self, p):
        return (p["friction"], p["friction"])

    def accelerations(self, p):
        def law(s):
            (a, b), (va, vb) = s.angles, s.speeds
            mass, far = p["camera"], p["camera"] * p["centre"] ** 2
            ta = p["kp"] * (s.efforts[0] - a) - p["kd"] * va - p["friction"] * s.direction(0) + s.load(0)
            tb = p["kp"] * (s.efforts[1] - b) - p["kd"] * vb - p["friction"] * s.direction(1) + s.load(1)
            cos, sin = torch.cos(b), torch.sin(b)
            ta = ta + 2.0 * far * cos * sin * va * vb
            tb = tb - far * cos * sin * va**2 - 9.81 * mass * p["centre"] * cos
            return ta / (p["base"] + far * cos**2), tb / (p["rotor"] + far)

        return law
