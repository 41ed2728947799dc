"""Joints in a diagnosis go by the names and the units that their system gives them."""

import numpy as np
import pytest

from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.residuals.residuals import MissingTorque
from deepkoco.diagnose.verdict.findings import localise
from deepkoco.diagnose.verdict.unknown import describe
from deepkoco.fit.solve.dispersion import Dispersion
from deepkoco.systems import ExtendedSystem, ParameterError, make_system
from deepkoco.systems.declaration import DeclarationError
from deepkoco.systems.effects import effects_of
from tests.systems.cart_pole import CartPole

CART = CartPole()


def missing(joint, unit, name, size):
    """A load on one joint that stands out in one slot of two windows."""
    grid = np.arange(6.0).reshape(2, 3)
    load = np.zeros((2, 3))
    load[1, 1] = size
    return MissingTorque(
        joint, unit, grid, np.zeros(2, int), load, 0.01 + 0.0 * grid, 0.1 * grid, grid, grid, grid, name
    )


def test_causes_and_effects_are_named_after_the_joints_of_their_system():
    for known in (catalogue(CART), effects_of(CART)):
        assert {"coulomb(cart)", "coulomb(pole)", "gain(cart)"} <= set(known)
        assert not [name for name in known if "joint" in name]


def test_names_of_joints_that_a_system_does_not_give_count_from_one():
    assert make_system("two_link_arm").joint_names == ("joint 1", "joint 2")
    assert "coulomb(joint 2)" in catalogue(make_system("two_link_arm"))
    assert "coulomb" in catalogue(make_system("rod_pendulum"))


def test_timing_of_a_command_reads_the_effects_of_the_named_joint():
    late = ExtendedSystem(CART, ("actuation_delay(cart)",), {"actuation_delay(cart).delay": 0.03})
    assert float(late.command_timing(0, late.default_parameters()).delay) == 0.03


@pytest.mark.parametrize(
    "names", [("cart", "cart"), ("cart", "pole (long)"), ("cart", ""), ("a.b", "c"), ("cart",)]
)
def test_unreadable_names_of_joints_are_refused(names):
    class Misnamed(CartPole):
        @property
        def joint_names(self):
            return names

    with pytest.raises(
        (ParameterError, DeclarationError),
        match=r"joint_names = .*: give (2 different names|a tuple with a name for each of 2 joints)",
    ):
        catalogue(Misnamed())


@pytest.mark.parametrize(
    ("loads", "keys", "name", "channel", "unit"),
    [
        ((2.0, 0.0), {"position_m", "speed_m_s", "force_n"}, "cart", "load on cart", "N"),
        ((0.0, 2.0), {"theta_rad", "omega_rad_s", "torque_nm"}, "pole", "load on pole", "N m"),
    ],
)
def test_worst_place_has_the_units_of_its_joint_in_its_keys(loads, keys, name, channel, unit):
    both = [missing(j, CART.load_units[j], CART.joint_names[j], size) for j, size in enumerate(loads)]
    worst = describe(both, Dispersion(2.0, 0.5, 1.0))["worst"]
    assert set(worst) == {"time_s", "joint", "joint_name", *keys}
    assert worst["joint_name"] == name
    (place,) = localise(both)
    assert (place.channel, place.unit) == (channel, unit)


def test_a_single_joint_that_slides_misses_a_force():
    (place,) = localise([missing(0, "N", "joint 1", 2.0)])
    assert (place.channel, place.unit) == ("force", "N")
