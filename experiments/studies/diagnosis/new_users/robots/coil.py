# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A voice coil that moves a stage on flexures."""

from deepkoco import Channel, Parameter, System


class Coil(System):
    """Current in, position out."""

    joint_names = ("stage",)
    joint_units = ("m",)
    parameters = (
        Parameter("mass", 0.3, "kg", 0.05, 2.0, 0.01, "moving part"),
        Parameter("motor", 6.0, "N/A", 0.5, 50.0, 0.2, "force per current"),
        Parameter("stiffness", 3000.0, "N/m", 100.0, 50000.0, 150.0, "flexures"),
        Parameter("viscous", 4.0, "N s/m", 0.0, 100.0, 1.0, "eddy currents"),
    )
    commands = (Channel("current", "A", "command", -1.0, 1.0),)
    measurements = (Channel("position", "m", "measurement", noise_sd=3e-7),)

    def accelerations(self, p):
        def law(s):
            force = p["motor"] * s.efforts[0] - p["stiffness"] * s.angles[0] - p["viscous"] * s.speeds[0]
            return ((force + s.load(0)) / p["mass"],)

        return law
