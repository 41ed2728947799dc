# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A ball-screw axis with a cascade of a position and a speed controller."""

from deepkoco import Channel, Parameter, System


class Axis(System):
    """Goal of the position in, position of the table out."""

    joint_names = ("table",)
    joint_units = ("m",)
    parameters = (
        Parameter("mass", 40.0, "kg", 5.0, 200.0, 2.0, "table, with the inertia of motor and screw"),
        Parameter("kv", 20.0, "1/s", 1.0, 100.0, 1.0, "position controller"),
        Parameter("kp", 2000.0, "N s/m", 100.0, 20000.0, 100.0, "speed controller"),
        Parameter("viscous", 150.0, "N s/m", 0.0, 2000.0, 75.0, "guides"),
    )
    commands = (Channel("goal", "m", "command", -0.3, 0.3),)
    measurements = (Channel("position", "m", "measurement", noise_sd=2e-6),)

    def accelerations(self, p):
        def law(s):
            x, v = s.angles[0], s.speeds[0]
            f = p["kp"] * (p["kv"] * (s.efforts[0] - x) - v) - p["viscous"] * v + s.load(0)
            return (f / p["mass"],)

        return law
