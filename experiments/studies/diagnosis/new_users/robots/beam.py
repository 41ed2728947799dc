# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A ball that rolls on a beam; a servo holds the beam at its goal."""

import torch

from deepkoco import Channel, Parameter, System


class Beam(System):
    """Goal of the beam's angle in; its angle and the place of the ball out."""

    joint_names = ("ball", "beam")
    joint_units = ("m", "rad")
    parameters = (
        Parameter("ball_mass", 0.05, "kg", 0.01, 0.5, 0.001, "solid ball"),
        Parameter("rolling", 0.02, "N s/m", 0.0, 0.5, 0.01, "losses of rolling"),
        Parameter("servo", 14.0, "rad/s", 2.0, 60.0, 1.0, "natural frequency of the servo, damping 0.8"),
    )
    commands = (Channel("goal", "rad", "command", -0.3, 0.3),)
    measurements = (
        Channel("place", "m", "measurement", noise_sd=1e-3),
        Channel("angle", "rad", "measurement", noise_sd=5e-4, angle=True),
    )
    command_joints = (1,)

    def accelerations(self, p):
        def law(s):
            (x, a), (v, w) = s.angles, s.speeds
            m, n = p["ball_mass"], p["servo"]
            force = -m * 9.81 * torch.sin(a) + m * x * w**2 - p["rolling"] * v + s.load(0)
            return force / (1.4 * m), n**2 * (s.efforts[0] - a) - 1.6 * n * w + s.load(1)

        return law
