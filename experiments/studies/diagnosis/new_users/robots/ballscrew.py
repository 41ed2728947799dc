# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A milling table on a ball screw: the motor turns the screw, and nut and screw give a little."""

import math

from deepkoco import Channel, Parameter, System

LEAD = 0.010 / (2.0 * math.pi)  # way of the nut per angle of the screw [m/rad]


class BallScrew(System):
    """Torque of the motor in; its resolver and a glass scale on the table out."""

    joint_names = ("motor", "table")
    joint_units = ("rad", "m")
    parameters = (
        Parameter("rotor", 1.1e-3, "kg m2", 1e-4, 0.02, 5e-5, "motor, coupling and screw"),
        Parameter("mass", 120.0, "kg", 10.0, 1000.0, 3.0, "table and workpiece"),
        Parameter("stiffness", 4e6, "N/m", 1e5, 1e8, 4e5, "of nut and screw along the axis"),
        Parameter("losses", 3000.0, "N s/m", 0.0, 1e5, 800.0, "of nut and screw"),
        Parameter("viscous", 0.004, "N m s/rad", 0.0, 0.1, 0.001, "motor and bearings of the screw"),
        Parameter("guides", 80.0, "N s/m", 0.0, 5000.0, 25.0, "lubricated guides of the table"),
    )
    commands = (Channel("torque", "N m", "command", -12.0, 12.0),)
    measurements = (
        Channel("resolver", "rad", "measurement", noise_sd=5e-4),
        Channel("scale", "m", "measurement", noise_sd=1e-6),
    )

    def accelerations(self, p):
        def law(s):
            (a, x), (w, v) = s.angles, s.speeds
            pull = p["stiffness"] * (LEAD * a - x) + p["losses"] * (LEAD * w - v)
            motor = s.efforts[0] - p["viscous"] * w - LEAD * pull + s.load(0)
            return motor / p["rotor"], (pull - p["guides"] * v + s.load(1)) / p["mass"]

        return law
