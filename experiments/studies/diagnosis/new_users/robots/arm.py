# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""One link with a PD controller that compensates gravity."""

import torch

from deepkoco import Channel, Parameter, System


class Arm(System):
    """Goal of the angle in; angle and speed out. The angle is 0 where the link hangs."""

    joint_names = ("elbow",)
    joint_units = ("rad",)
    parameters = (
        Parameter("mass", 1.2, "kg", 0.2, 5.0, 0.03, "link"),
        Parameter("centre", 0.16, "m", 0.02, 0.5, 0.004, "centre of mass"),
        Parameter("inertia", 0.012, "kg m2", 1e-3, 0.2, 0.001, "about the centre of mass, with the rotor"),
        Parameter("viscous", 0.05, "N m s/rad", 0.0, 1.0, 0.02, "bearings"),
        Parameter("kp", 30.0, "N m/rad", 1.0, 300.0, 0.6, "controller"),
        Parameter("kd", 1.2, "N m s/rad", 0.0, 30.0, 0.03, "controller"),
        Parameter(
            "compensation", 1.0, "1", 0.0, 2.0, 0.02, "share of the weight that the controller holds up"
        ),
    )
    commands = (Channel("goal", "rad", "command", -3.2, 3.2),)
    measurements = (
        Channel("angle", "rad", "measurement", noise_sd=2e-4, angle=True),
        Channel("speed", "rad/s", "measurement", noise_sd=0.01),
    )

    def with_payload(self, mass, p):
        whole = p["mass"] + mass
        centre = (p["mass"] * p["centre"] + mass * 0.35) / whole
        shift = p["mass"] * p["centre"] ** 2 + mass * 0.35**2 - whole * centre**2
        return {**p, "mass": whole, "centre": centre, "inertia": p["inertia"] + shift}

    def accelerations(self, p):
        def law(s):
            q, w = s.angles[0], s.speeds[0]
            weight = p["mass"] * p["centre"] * 9.81
            held = p["compensation"] * 1.2 * 0.16 * 9.81
            t = p["kp"] * (s.efforts[0] - q) - (p["kd"] + p["viscous"]) * w + (held - weight) * torch.sin(q)
            return ((t + s.load(0)) / (p["inertia"] + p["mass"] * p["centre"] ** 2),)

        return law
