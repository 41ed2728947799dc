"""EMPS of nonlinearbenchmark.org as its user would declare it: a car on a ball screw, driven by a force."""

from deepkoco import Channel, Parameter, System


class Emps(System):
    """M q'' = F - F_v q': nobody has told it of dry friction or of an offset."""

    joint_names = ("car",)  # pyright: ignore[reportAssignmentType]
    joint_units = ("m",)
    parameters = (
        Parameter("mass", 100.0, "kg", 10.0, 500.0, 50.0, "M, car and rotor seen from the car"),
        Parameter("viscous", 200.0, "N s/m", 0.0, 2000.0, 200.0, "F_v"),
    )
    commands = (Channel("force", "N", "command", -350.0, 350.0),)  # pyright: ignore[reportAssignmentType]
    measurements = (Channel("q", "m", "measurement", noise_sd=2e-6),)

    def accelerations(self, p):
        def law(motion):
            return ((motion.efforts[0] - p["viscous"] * motion.speeds[0] + motion.load(0)) / p["mass"],)

        return law
