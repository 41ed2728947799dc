"""Actuators that are no load on one joint: names of their effects, and a constant load beside them."""

import pytest
import torch

from deepkoco import Channel, Parameter, System
from deepkoco.diagnose.causes import catalogue
from deepkoco.systems import make_system, system_names
from deepkoco.systems.drives import Drive
from tests.systems.cart_pole import CartPole


class Boat(System):
    """Two thrusters push a boat along its heading, and turn it."""

    joint_names = ("north", "east", "heading")
    joint_units = ("m", "m", "rad")
    command_joints = (0, 2)
    parameters = (Parameter("mass", 28.0, "kg", 5.0, 200.0, 1.5, "m"),)
    commands = (
        Channel("port", "N", "command", -40.0, 40.0),
        Channel("starboard", "N", "command", -40.0, 40.0),
    )
    measurements = tuple(
        Channel(n, u, "measurement", noise_sd=0.01)
        for n, u in zip(("north", "east", "heading"), ("m", "m", "rad"), strict=True)
    )

    def accelerations(self, p):
        def law(motion):
            port, starboard = motion.efforts
            heading = motion.angles[2]
            return (
                ((port + starboard) * torch.cos(heading) + motion.load(0)) / p["mass"],
                ((port + starboard) * torch.sin(heading) + motion.load(1)) / p["mass"],
                (0.3 * (port - starboard) + motion.load(2)) / 6.0,
            )

        return law


class Propeller(System):
    """One joint, pushed by the square of the command."""

    joint_units = "m"
    parameters = (Parameter("mass", 1.0, "kg", 0.1, 10.0, 0.1, "m"),)
    commands = (Channel("speed", "1", "command", 0.0, 10.0),)
    measurements = (Channel("height", "m", "measurement", noise_sd=1e-3),)

    def accelerations(self, p):
        return lambda motion: (
            (0.2 * motion.efforts[0] ** 2 - 9.81 * p["mass"] + motion.load(0)) / p["mass"],
        )


def test_effects_of_a_thruster_that_turns_with_the_body_are_named_after_it():
    known = set(catalogue(Boat()))
    assert {"gain(port)", "gain(starboard)", "actuation_delay(port)", "lag(all)"} <= known
    assert not {"gain(north)", "gain(heading)"} & known


def test_a_constant_load_is_tried_at_a_joint_whose_actuator_has_no_bias_like_it():
    assert {f"constant_load({n})" for n in Boat.joint_names} <= set(catalogue(Boat()))
    assert "constant_load" in catalogue(Propeller())


def test_an_actuator_that_acts_as_a_load_needs_no_constant_load_beside_its_bias():
    known = catalogue(CartPole())
    assert "constant_load(cart)" not in known
    assert "constant_load(pole)" in known
    assert "torque_bias(cart)" in known


@pytest.mark.parametrize("name", system_names())
def test_effects_of_the_systems_of_the_package_keep_the_names_of_their_joints(name):
    system = make_system(name)
    assert all(drive.along for drive in system.drives)


def test_a_thruster_with_the_name_of_another_joint_leaves_its_effects_the_name_of_its_joint():
    class Named(Boat):
        joint_names = ("north", "port", "heading")

    known = set(catalogue(Named()))
    assert {"gain(north)", "gain(starboard)"} <= known
    assert "gain(port)" not in known


def test_a_square_law_drives_along_its_joint_without_being_a_constant_load():
    assert Propeller().drives == (Drive(along=True, constant=False),)
