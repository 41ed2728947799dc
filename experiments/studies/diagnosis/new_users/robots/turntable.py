# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A turntable on a bus servo, which may turn without end."""

from deepkoco import Channel, Parameter, System


class Turntable(System):
    """Goal of the position in, position out."""

    joint_names = ("table",)
    joint_units = ("rad",)
    parameters = (
        Parameter("kp", 12.0, "N m/rad", 0.5, 100.0, 1.0, "servo"),
        Parameter("kd", 0.9, "N m s/rad", 0.01, 10.0, 0.1, "servo, with its back EMF"),
        Parameter("inertia", 0.03, "kg m2", 1e-3, 0.5, 0.0015, "table"),
        Parameter("friction", 0.08, "N m", 0.0, 1.0, 0.02, "dry friction of the gears"),
    )
    commands = (Channel("goal", "rad", "command", -100.0, 100.0),)
    measurements = (Channel("position", "rad", "measurement", noise_sd=6e-4, angle=True),)

    def dry_friction_limits(self, p):
        return (p["friction"],)

    def accelerations(self, p):
        def law(s):
            w = s.speeds[0]
            t = p["kp"] * (s.efforts[0] - s.angles[0]) - p["kd"] * w + s.load(0)
            return ((t - p["friction"] * s.direction(0)) / p["inertia"],)

        return law
