# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A small motor with a gearbox behind an H bridge."""

from deepkoco import Channel, Parameter, System


class Geared(System):
    """Duty cycle in, angle of the motor's shaft out."""

    joint_names = ("shaft",)
    joint_units = ("rad",)
    parameters = (
        Parameter("supply", 12.0, "V", 5.0, 30.0, 0.3, "of the H bridge"),
        Parameter("constant", 0.02, "N m/A", 0.001, 0.5, 4e-4, "K"),
        Parameter("resistance", 2.0, "1", 0.2, 20.0, 0.1, "R [Ohm]"),
        Parameter("inertia", 3e-5, "kg m2", 1e-6, 1e-3, 3e-6, "rotor, gears and load, on the motor's side"),
        Parameter("viscous", 2e-6, "N m s/rad", 0.0, 1e-3, 1e-6, "bearings"),
        Parameter("friction", 0.006, "N m", 0.0, 0.1, 0.001, "dry friction of the gears"),
    )
    commands = (Channel("duty", "1", "command", -1.0, 1.0),)
    measurements = (Channel("angle", "rad", "measurement", noise_sd=1e-3, angle=True),)

    def dry_friction_limits(self, p):
        return (p["friction"],)

    def accelerations(self, p):
        def law(s):
            w, k = s.speeds[0], p["constant"]
            t = k * (p["supply"] * s.efforts[0] - k * w) / p["resistance"] - p["viscous"] * w
            return ((t - p["friction"] * s.direction(0) + s.load(0)) / p["inertia"],)

        return law
