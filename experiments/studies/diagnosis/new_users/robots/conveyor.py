# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A belt conveyor: a drive with an inverter turns the drum, and a measuring wheel runs on the belt."""

from deepkoco import Channel, Parameter, System


class Conveyor(System):
    """Goal of the inverter's speed in; speed of the motor and way of the belt out."""

    joint_names = ("belt",)
    joint_units = ("m",)
    parameters = (
        Parameter("moved", 90.0, "kg", 5.0, 2000.0, 5.0, "belt, load, drum and rotor, as seen at the belt"),
        Parameter("control", 450.0, "N s/m", 10.0, 1e4, 40.0, "speed controller of the inverter"),
        Parameter("viscous", 30.0, "N s/m", 0.0, 1000.0, 10.0, "rollers"),
        Parameter("rubbing", 25.0, "N", 0.0, 500.0, 8.0, "belt on its bed"),
    )
    commands = (Channel("goal", "m/s", "command", -2.0, 2.0),)
    measurements = (
        Channel("way", "m", "measurement", noise_sd=2e-4),
        Channel("drum", "m/s", "measurement", noise_sd=2e-3),
    )

    def dry_friction_limits(self, p):
        return (p["rubbing"],)

    def accelerations(self, p):
        def law(s):
            v = s.speeds[0]
            force = p["control"] * (s.efforts[0] - v) - p["viscous"] * v
            force = force - p["rubbing"] * s.direction(0, over=1e-3) + s.load(0)
            return (force / p["moved"],)

        return law
