# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A robot that balances on two wheels."""

import torch

from deepkoco import Channel, Parameter, System


class Balancer(System):
    """Current of both motors in; the encoders read the wheels against the body."""

    joint_names = ("wheel", "body")
    joint_units = ("rad", "rad")
    parameters = (
        Parameter("body_mass", 0.9, "kg", 0.2, 5.0, 0.01, "without wheels"),
        Parameter("wheel_mass", 0.25, "kg", 0.02, 2.0, 0.005, "both, with their inertia"),
        Parameter("height", 0.09, "m", 0.01, 0.5, 0.003, "centre of mass above the axle"),
        Parameter("body_inertia", 0.003, "kg m2", 3e-4, 0.05, 2e-4, "about the centre of mass"),
        Parameter("constant", 0.06, "N m/A", 0.005, 0.5, 0.002, "both motors, behind the gears"),
        Parameter("gear", 0.002, "N m s/rad", 0.0, 0.05, 5e-4, "viscous friction of the gears"),
    )
    commands = (Channel("current", "A", "command", -8.0, 8.0),)
    measurements = (
        Channel("wheel", "rad", "measurement", noise_sd=1e-3, angle=True),
        Channel("pitch", "rad", "measurement", noise_sd=2e-3, angle=True),
        Channel("gyro", "rad/s", "measurement", noise_sd=0.01),
    )
    measured_states = (0, 1, 3)

    def ideal_measurement(self, state):
        return state[..., [0, 1, 3]]

    def accelerations(self, p):
        def law(s):
            (_, a), (spin, w) = s.angles, s.speeds
            m, h, r, c = p["body_mass"], p["height"], 0.04, torch.cos(a)
            t = p["constant"] * s.efforts[0] - p["gear"] * spin + s.load(0)
            f, g = t / r + m * h * w**2 * torch.sin(a), m * 9.81 * h * torch.sin(a) - t + s.load(1)
            m11, m12, m22 = m + p["wheel_mass"], m * h * c, m * h * h + p["body_inertia"]
            d = m11 * m22 - m12**2
            push, fall = (m22 * f - m12 * g) / d, (m11 * g - m12 * f) / d
            return push / r - fall, fall

        return law
