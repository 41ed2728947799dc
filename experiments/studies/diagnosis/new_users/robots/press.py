# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A horizontal press with a hydraulic cylinder, whose two sides have different areas."""

import torch

from deepkoco import Channel, Parameter, System


class Press(System):
    """Opening of the valve in; place of the piston out."""

    joint_names = ("piston",)
    joint_units = ("m",)
    parameters = (
        Parameter("moved", 180.0, "kg", 20.0, 2000.0, 6.0, "piston, ram and tool"),
        Parameter("pressure", 2.6e6, "Pa", 5e5, 4e7, 1e5, "of the pump"),
        Parameter("bore", 1.26e-3, "m2", 1e-4, 2e-2, 1e-5, "area of the side of the pump"),
        Parameter("ring", 0.77e-3, "m2", 1e-4, 2e-2, 1e-5, "area of the side of the rod"),
        Parameter("flow", 4.5e-4, "m3/s", 1e-5, 1e-2, 3e-5, "through the open valve"),
        Parameter("oil", 2.0e4, "N s/m", 1e3, 1e6, 3e3, "force per speed that the piston lacks"),
    )
    commands = (Channel("valve", "1", "command", -1.0, 1.0),)
    measurements = (Channel("way", "m", "measurement", noise_sd=2e-5),)

    def accelerations(self, p):
        def law(s):
            u, v = s.efforts[0], s.speeds[0]
            # The pump fills one side; the piston follows its flow as far as its pressure reaches.
            area = torch.where(u > 0.0, p["bore"], p["ring"])
            force = p["oil"] * (p["flow"] * u / area - v)
            force = torch.minimum(torch.maximum(force, -p["pressure"] * p["ring"]), p["pressure"] * p["bore"])
            return ((force + s.load(0)) / p["moved"],)

        return law
