# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""A cart on a rail with a hanging uniform rod; a force drives the cart."""

import torch

from deepkoco import Channel, Parameter, System


class Cart(System):
    """Force on the cart, angle 0 where the rod hangs."""

    name = "lab_cart"
    joint_names = ("cart", "pole")
    joint_units = ("m", "rad")
    parameters = (
        Parameter("cart_mass", 0.8, "kg", 0.05, 5.0, 0.03, "M"),
        Parameter("pole_mass", 0.20, "kg", 0.01, 2.0, 0.01, "m, uniform rod"),
        Parameter("length", 0.5, "m", 0.05, 2.0, 0.005, "L, of the rod"),
        Parameter("cart_viscous", 0.8, "N s/m", 0.0, 10.0, 0.3, "b"),
        Parameter("pole_viscous", 0.001, "N m s/rad", 0.0, 1.0, 0.001, "c"),
    )
    commands = (Channel("force", "N", "command", -10.0, 10.0),)
    measurements = (
        Channel("position", "m", "measurement", noise_sd=1e-4),
        Channel("angle", "rad", "measurement", noise_sd=1e-3, angle=True),
    )

    def accelerations(self, p):
        def law(s):
            (_, a), (v, w) = s.angles, s.speeds
            half = p["pole_mass"] * p["length"] / 2
            f = s.efforts[0] - p["cart_viscous"] * v + half * w**2 * torch.sin(a) + s.load(0)
            t = -half * 9.81 * torch.sin(a) - p["pole_viscous"] * w + s.load(1)
            m11, m12, m22 = (
                p["cart_mass"] + p["pole_mass"],
                half * torch.cos(a),
                p["pole_mass"] * p["length"] ** 2 / 3,
            )
            d = m11 * m22 - m12**2
            return (m22 * f - m12 * t) / d, (m11 * t - m12 * f) / d

        return law
