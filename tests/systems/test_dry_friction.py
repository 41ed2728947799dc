"""Dry friction as a constraint: coupled joints against a bounded least-squares problem, limits of systems."""

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from deepkoco.systems import Channel, ExtendedSystem, Motion, Parameter, System, make_system
from deepkoco.systems.dry_friction import rubbed, slide_and_rest

H = 0.01


class Block(System):
    """A block that rubs, as a user writes it."""

    parameters = (
        Parameter("mass", 2.0, "kg", 0.1, 10.0, 0.1, "m"),
        Parameter("friction", 3.0, "N", 0.0, 10.0, 0.1, "dry"),
    )
    joint_units = ("m",)
    commands = (Channel("force", "N", "command", -10.0, 10.0),)
    measurements = (Channel("place", "m", "measurement", noise_sd=1e-4),)

    def dry_friction_limits(self, p):
        return (p["friction"],)

    def accelerations(self, p):
        return lambda s: ((s.efforts[0] - p["friction"] * s.direction(0, over=1e-3) + s.load(0)) / p["mass"],)


def test_friction_along_the_direction_of_a_motion_is_left_out_where_the_joint_sticks():
    block = Block()
    p, motion = block.default_parameters(), Motion(tensors([0.0]), tensors([1.0]), tensors([7.0]))
    assert float(block.accelerations(p)(motion)[0]) == pytest.approx((7.0 - 3.0) / 2.0)
    assert float(block.free_accelerations(p)(motion)[0]) == pytest.approx(7.0 / 2.0)
    slow = motion._replace(speeds=tensors([1e-3]))  # tanh(1) of the friction
    assert float(block.accelerations(p)(slow)[0]) == pytest.approx((7.0 - 3.0 * np.tanh(1.0)) / 2.0)


def tensors(values):
    return tuple(torch.tensor(float(v), dtype=torch.float64) for v in values)


def coupled(joints, seed):
    """Inverse inertia, free accelerations and levels of joints that drag on each other."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((joints, joints))
    inverse = root @ root.T + 0.3 * np.eye(joints)
    return inverse, rng.standard_normal(joints) * 3.0, rng.uniform(0.0, 2.0, joints)


def solved(inverse, free, levels, before):
    nothing = tensors(np.zeros(len(levels)))
    after = tensors(before + H * free)
    level = tensors(levels)
    return rubbed(tensors(before), after, nothing, level, level, tuple(map(tensors, inverse)), H)


@settings(deadline=None)
@given(joints=st.integers(1, 5), seed=st.integers(0, 10_000))
@example(joints=5, seed=588)  # drags so hard that 60 sweeps do not settle it
def test_joints_at_rest_take_the_loads_that_leave_the_least_motion(joints, seed):
    inverse, free, levels = coupled(joints, seed)
    found = solved(inverse, free, levels, np.zeros(joints))
    # Loads l in [-F, F] minimise (a + W l)^T M (a + W l): friction takes as much energy as it can.
    root = np.linalg.cholesky(np.linalg.inv(inverse)).T
    best = lsq_linear(root @ inverse, -root @ free, (-levels - 1e-12, levels + 1e-12), tol=1e-14)
    speed = H * (free + inverse @ best.x)
    assert np.array(found.speed) == pytest.approx(speed, abs=1e-6)


@settings(deadline=None)
@given(joints=st.integers(1, 5), seed=st.integers(0, 10_000), pace=st.floats(0.0, 0.1))
@example(joints=5, seed=158, pace=0.0)
def test_friction_of_coupled_joints_stays_within_its_level(joints, seed, pace):
    inverse, free, levels = coupled(joints, seed)
    before = pace * np.random.default_rng([seed, 1]).standard_normal(joints)
    found = solved(inverse, free, levels, before)
    load = np.array(found.load)
    assert (np.abs(load) <= levels + 1e-9).all()
    after = before + H * (free + inverse @ load)
    assert np.array(found.speed) == pytest.approx(after, abs=1e-6)
    slides = (before * after > 0.0) & (np.abs(after) > 1e-6)
    assert load[slides] == pytest.approx(-np.sign(before[slides]) * levels[slides], abs=1e-6)


def test_one_joint_by_hand():
    # 0.02 m/s, braked by 1 - (-3) = 4 m/s2: at rest after 5 ms and 5e-5 m. Then -3 + 1 = -2 m/s2 over 5 ms.
    speed, moved = slide_and_rest(*tensors((0.02, -3.0, 1.0, 1.0)), H)
    assert float(speed) == pytest.approx(-0.01)
    assert float(moved) == pytest.approx(5e-5 - 2.5e-5)
    # Friction of 3.5 at rest holds it against 3.
    speed, moved = slide_and_rest(*tensors((0.02, -3.0, 1.0, 3.5)), H)
    assert float(speed) == 0.0
    assert float(moved) == pytest.approx(5e-5)


def test_limits_are_the_bases_and_the_effects_and_never_below_zero():
    base = make_system("pendulum")
    own = float(base.default_parameters()["coulomb"])
    values = {"coulomb.torque": 1e-3, "stribeck.coulomb": 2e-3, "stribeck.breakaway": 5e-4}
    system = ExtendedSystem(base, ("coulomb", "stribeck", "load_friction"), values)
    (limit,) = system.dry_friction_limits(system.default_parameters())
    assert float(limit) == pytest.approx(own + 3.5e-3)
    less = ExtendedSystem(base, ("coulomb",), {"coulomb.torque": -0.01})
    assert [float(x) for x in less.dry_friction_limits(less.default_parameters())] == [0.0]
    arm = ExtendedSystem(make_system("two_link_arm"), ("coulomb(joint 2)",), {"coulomb(joint 2).torque": 0.3})
    first, second = arm.dry_friction_limits(arm.default_parameters())
    assert first is None
    assert float(second) == 0.3


@pytest.mark.parametrize("name", ["pendulum", "two_link_arm", "double_pendulum", "furuta_pendulum"])
def test_inverse_inertia_is_what_unit_loads_do(name):
    system = make_system(name)
    rng = np.random.default_rng(4)
    angles, speeds = (tensors(rng.standard_normal(system.joints)) for _ in range(2))
    efforts = tensors(rng.standard_normal(len(system.commands)))
    p = system.default_parameters()
    inverse = np.array(
        [[float(x) for x in row] for row in system.inverse_inertia(p)(Motion(angles, speeds, efforts))]
    )
    assert inverse == pytest.approx(inverse.T, rel=1e-6)
    assert np.linalg.eigvalsh(0.5 * (inverse + inverse.T)).min() > 0.0
    law = system.free_accelerations(p)
    loads = 1e-3 * rng.standard_normal(system.joints)
    moved = np.array(law(Motion(angles, speeds, efforts, tensors(loads)))) - np.array(
        law(Motion(angles, speeds, efforts))
    )
    assert moved == pytest.approx(inverse @ loads, rel=1e-6)


def test_free_accelerations_leave_dry_friction_out():
    base = make_system("pendulum")
    p = base.default_parameters()
    motion = Motion(tensors([0.3]), tensors([2.0]), tensors([0.0]))
    (free,), (rubbing,) = base.free_accelerations(p)(motion), base.accelerations(p)(motion)
    assert float(free - rubbing) == pytest.approx(float(p["coulomb"] / p["inertia"]), rel=1e-6)
