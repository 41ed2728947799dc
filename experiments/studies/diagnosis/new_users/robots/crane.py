# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A trolley with a speed drive, and a load on a cable."""

import torch

from deepkoco import Channel, Parameter, System


class Crane(System):
    """Speed goal of the trolley, sway of the load."""

    joint_names = ("trolley", "sway")
    joint_units = ("m", "rad")
    parameters = (
        Parameter("drive_gain", 60.0, "N s/m", 5.0, 500.0, 10.0, "of the speed controller"),
        Parameter("trolley_mass", 4.0, "kg", 0.5, 50.0, 0.2, "M"),
        Parameter("load_mass", 1.5, "kg", 0.1, 10.0, 0.05, "m"),
        Parameter("cable", 1.2, "m", 0.2, 5.0, 0.02, "from trolley to the centre of the load"),
        Parameter("air", 0.02, "N m s/rad", 0.0, 1.0, 0.02, "damping of the sway"),
    )
    commands = (Channel("speed_goal", "m/s", "command", -1.0, 1.0),)
    measurements = (
        Channel("position", "m", "measurement", noise_sd=5e-4),
        Channel("speed", "m/s", "measurement", noise_sd=5e-3),
        Channel("sway", "rad", "measurement", noise_sd=2e-3, angle=True),
    )
    measured_states = (0, 2, 1)

    def ideal_measurement(self, state):
        return state[..., [0, 2, 1]]

    def accelerations(self, p):
        def law(s):
            (_, a), (v, w) = s.angles, s.speeds
            ml = p["load_mass"] * p["cable"]
            f = p["drive_gain"] * (s.efforts[0] - v) + ml * w**2 * torch.sin(a) + s.load(0)
            t = -ml * 9.81 * torch.sin(a) - p["air"] * w + s.load(1)
            m11, m12, m22 = p["trolley_mass"] + p["load_mass"], ml * torch.cos(a), ml * p["cable"]
            d = m11 * m22 - m12**2
            return (m22 * f - m12 * t) / d, (m11 * t - m12 * f) / d

        return law
