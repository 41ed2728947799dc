# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A hydraulic cylinder: the valve sets the speed, with a first-order lag."""

from deepkoco import Channel, Parameter, System


class Cylinder(System):
    """Voltage of the valve in, stroke out."""

    joint_names = ("piston",)
    joint_units = ("m",)
    parameters = (
        Parameter("flow_gain", 0.04, "m/s/V", 0.005, 0.5, 0.004, "speed per volt of the valve"),
        Parameter("time_constant", 0.06, "s", 0.005, 0.5, 0.006, "of valve and oil"),
    )
    commands = (Channel("valve", "V", "command", -10.0, 10.0),)
    measurements = (Channel("stroke", "m", "measurement", noise_sd=1e-4),)

    def accelerations(self, p):
        def law(s):
            return ((p["flow_gain"] * s.efforts[0] - s.speeds[0]) / p["time_constant"] + s.load(0),)

        return law
