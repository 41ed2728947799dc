# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A DC motor that turns a load by a belt, stiff or elastic; only its encoder is read."""

from deepkoco import Channel, Parameter, System

P = (
    Parameter("constant", 0.06, "N m/A", 0.005, 0.5, 6e-4, "K"),
    Parameter("resistance", 1.5, "1", 0.2, 20.0, 0.03, "R [Ohm]"),
    Parameter("motor_inertia", 6e-5, "kg m2", 5e-6, 5e-4, 1e-6, "rotor and pulley"),
    Parameter("load_inertia", 2e-4, "kg m2", 1e-5, 2e-3, 2e-5, "load"),
    Parameter("viscous", 2e-4, "N m s/rad", 0.0, 1e-2, 1e-4, "b"),
)


class Stiff(System):
    """Motor and load are one inertia."""

    joint_names = ("motor",)
    joint_units = ("rad",)
    parameters = P
    commands = (Channel("voltage", "V", "command", -24.0, 24.0),)
    measurements = (Channel("angle", "rad", "measurement", noise_sd=1e-3, angle=True),)

    def accelerations(self, p):
        def law(s):
            w = s.speeds[0]
            t = (
                p["constant"] * (s.efforts[0] - p["constant"] * w) / p["resistance"]
                - p["viscous"] * w
                + s.load(0)
            )
            return (t / (p["motor_inertia"] + p["load_inertia"]),)

        return law


class Belt(System):
    """The load is a joint of its own, which nothing measures."""

    joint_names = ("motor", "load")
    joint_units = ("rad", "rad")
    parameters = (
        *P,
        Parameter("stiffness", 1.0, "N m/rad", 0.01, 100.0, 0.5, "k"),
        Parameter("belt_damping", 1e-3, "N m s/rad", 0.0, 0.1, 1e-3, "d"),
    )
    commands = Stiff.commands
    measurements = Stiff.measurements

    def accelerations(self, p):
        def law(s):
            (a, b), (v, w) = s.angles, s.speeds
            belt = p["stiffness"] * (b - a) + p["belt_damping"] * (w - v)
            t = p["constant"] * (s.efforts[0] - p["constant"] * v) / p["resistance"] + belt + s.load(0)
            return t / p["motor_inertia"], (-belt - p["viscous"] * w + s.load(1)) / p["load_inertia"]

        return law
