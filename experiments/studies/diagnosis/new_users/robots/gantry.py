# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A gantry: two linear motors carry one beam, whose guides are a little soft."""

from deepkoco import Channel, Parameter, System


class Gantry(System):
    """Currents of both motors in; both linear scales out."""

    joint_names = ("y1", "y2")
    joint_units = ("m", "m")
    parameters = (
        Parameter("beam", 14.0, "kg", 2.0, 100.0, 0.3, "beam and carriage"),
        Parameter("turning", 0.9, "kg m2", 0.05, 20.0, 0.05, "inertia of the beam about its centre"),
        Parameter("span", 0.8, "m", 0.2, 3.0, 0.002, "between the motors"),
        Parameter("force", 38.0, "N/A", 5.0, 300.0, 1.0, "of a motor per ampere"),
        Parameter("guides", 4.0e4, "N/m", 1e3, 1e6, 4e3, "stiffness against skew, at the motors"),
        Parameter("losses", 60.0, "N s/m", 0.0, 2000.0, 20.0, "damping of the skew"),
        Parameter("viscous", 25.0, "N s/m", 0.0, 300.0, 8.0, "friction of one rail"),
    )
    commands = (
        Channel("current1", "A", "command", -12.0, 12.0),
        Channel("current2", "A", "command", -12.0, 12.0),
    )
    measurements = (
        Channel("scale1", "m", "measurement", noise_sd=1e-6),
        Channel("scale2", "m", "measurement", noise_sd=1e-6),
    )

    def accelerations(self, p):
        def law(s):
            (a, b), (va, vb) = s.angles, s.speeds
            skew = p["guides"] * (a - b) + p["losses"] * (va - vb)
            fa = p["force"] * s.efforts[0] - p["viscous"] * va - skew + s.load(0)
            fb = p["force"] * s.efforts[1] - p["viscous"] * vb + skew + s.load(1)
            # The beam moves with its centre and turns about it.
            centre, turn = (fa + fb) / p["beam"], (fb - fa) * p["span"] ** 2 / (4.0 * p["turning"])
            return centre - turn, centre + turn

        return law
