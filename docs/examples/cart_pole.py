"""A cart on a rail with a hanging pole: deepkoco diagnose LOG --system cart_pole.py:CartPole."""

import torch

from deepkoco import Channel, Parameter, System


class CartPole(System):
    """A force drives the cart; the pole is a point mass on a rod, at angle 0 when it hangs."""

    name = "cart_pole"
    joint_names = ("cart", "pole")
    joint_units = ("m", "rad")
    parameters = (  # value, unit, bounds, how well it is known (standard deviation), a phrase
        Parameter("cart_mass", 0.6, "kg", 0.05, 5.0, 0.02, "M, mass of the cart"),
        Parameter("pole_mass", 0.2, "kg", 0.01, 2.0, 0.01, "m, mass at the end of the rod"),
        Parameter("length", 0.3, "m", 0.05, 2.0, 0.005, "l, from the pivot to the mass"),
        Parameter("cart_viscous", 0.5, "N s/m", 0.0, 10.0, 0.1, "b, friction of the cart"),
        Parameter("pole_viscous", 0.002, "N m s/rad", 0.0, 1.0, 0.001, "c, friction of the pivot"),
    )
    commands = (Channel("force", "N", "command", -10.0, 10.0),)
    measurements = (
        Channel("position", "m", "measurement", noise_sd=1e-4),
        Channel("angle", "rad", "measurement", noise_sd=1e-3, angle=True),
    )

    def accelerations(self, p):
        def law(motion):
            (_, angle), (speed, swing) = motion.angles, motion.speeds
            sine, cosine = torch.sin(angle), torch.cos(angle)
            hanging = p["pole_mass"] * p["length"]
            force = motion.efforts[0] - p["cart_viscous"] * speed + hanging * swing**2 * sine + motion.load(0)
            torque = -hanging * 9.81 * sine - p["pole_viscous"] * swing + motion.load(1)
            m11, m12, m22 = p["cart_mass"] + p["pole_mass"], hanging * cosine, hanging * p["length"]
            determinant = m11 * m22 - m12**2
            return (m22 * force - m12 * torque) / determinant, (m11 * torque - m12 * force) / determinant

        return law
