# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A gantry crane with a hoist."""

import torch

from deepkoco import Channel, Parameter, System


class Hoist(System):
    """Goals of two speeds in; place of the trolley, sway and length of the cable out."""

    joint_names = ("trolley", "sway", "cable")
    joint_units = ("m", "rad", "m")
    parameters = (
        Parameter("trolley", 60.0, "kg", 10.0, 500.0, 2.0, "with motor and wheels"),
        Parameter("load", 25.0, "kg", 1.0, 500.0, 0.5, "with the hook"),
        Parameter("drum", 15.0, "kg", 0.0, 200.0, 2.0, "drum and motor, as seen at the cable"),
        Parameter("travel_gain", 400.0, "N s/m", 10.0, 5000.0, 40.0, "speed controller of the trolley"),
        Parameter("hoist_gain", 900.0, "N s/m", 10.0, 9000.0, 90.0, "speed controller of the hoist"),
        Parameter("air", 0.5, "N m s/rad", 0.0, 10.0, 0.3, "resistance of the load"),
    )
    commands = (
        Channel("travel", "m/s", "command", -1.0, 1.0),
        Channel("lower", "m/s", "command", -0.5, 0.5),
    )
    measurements = (
        Channel("place", "m", "measurement", noise_sd=7e-4),
        Channel("sway", "rad", "measurement", noise_sd=1.2e-3, angle=True),
        Channel("length", "m", "measurement", noise_sd=7e-4),
    )
    command_joints = (0, 2)

    def accelerations(self, p):
        def law(s):
            (_, a, c), (v, w, d) = s.angles, s.speeds
            m, sin, cos = p["load"], torch.sin(a), torch.cos(a)
            # Forces along x, along the sway, and along the cable; the hoist holds the weight up by itself.
            fx = p["travel_gain"] * (s.efforts[0] - v) + s.load(0)
            fa = (s.load(1) - p["air"] * w) / c
            fl = p["hoist_gain"] * (s.efforts[1] - d) - m * 9.81 + s.load(2)
            # The load's own equations along and across the cable; the pull of the cable joins trolley and drum.
            along, across = fl + m * 9.81 * cos + m * c * w**2, fa - m * 9.81 * sin - 2.0 * m * d * w
            # M [x'', l a'', l''] = [fx + m (l w^2 sin - 2 d w cos), across, along] with the masses below.
            right = fx + m * (c * w**2 * sin - 2.0 * d * w * cos)
            n = m + p["drum"]
            ax = (right - cos * across - m * sin * along / n) / (
                p["trolley"] + m - m * cos**2 - m**2 * sin**2 / n
            )
            return ax, (across / m - cos * ax) / c, (along - m * sin * ax) / n

        return law
