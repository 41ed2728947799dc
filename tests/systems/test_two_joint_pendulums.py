"""The Furuta and the double pendulum against equations that sympy derives from the places of their masses."""

import numpy as np
import pytest
import sympy
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems import ExtendedSystem, Motion, make_system, rk4_step

ANGLE, SPEED = st.floats(-4.0, 4.0), st.floats(-8.0, 8.0)
DRIVE = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
T = sympy.Symbol("t")
Q = [sympy.Function(f"q{i}")(T) for i in (1, 2)]


def euler_lagrange(lagrangian, forces):
    """Accelerations as a function of (q1, q2, v1, v2, *names of the forces)."""
    speeds, rates = [q.diff(T) for q in Q], [q.diff(T, 2) for q in Q]
    equations = [
        lagrangian.diff(v).diff(T) - lagrangian.diff(q) - f for q, v, f in zip(Q, speeds, forces, strict=True)
    ]
    matrix, right = sympy.linear_eq_to_matrix([sympy.expand(e) for e in equations], rates)
    plain = sympy.symbols("q1 q2 v1 v2 u1 u2")
    swap = list(zip([*speeds, *Q], [*plain[2:4], *plain[:2]], strict=True))
    return sympy.lambdify(plain, (matrix.subs(swap), right.subs(swap)), "numpy")


def solved(function, state, drive):
    matrix, right = function(*state, *drive)
    return np.linalg.solve(np.asarray(matrix, float), np.asarray(right, float)).ravel()


def nominal(name, **extra):
    return {p.name: p.value for p in make_system(name).parameters} | extra


def furuta_equations(p):
    """A uniform rod: its elements lie at L_a e_r + x (sin alpha e_t + cos alpha e_z); a point mass at its tip."""
    theta, alpha = Q
    u = sympy.Symbol("u1")
    radial = sympy.Matrix([sympy.cos(theta), sympy.sin(theta), 0])
    across = sympy.Matrix([-sympy.sin(theta), sympy.cos(theta), 0])
    up = sympy.Matrix([0, 0, 1])
    lift = sympy.Matrix([-p["gravity_x"], -p["gravity_y"], 9.81])  # potential energy per mass and place
    x = sympy.Symbol("x", positive=True)
    place = p["arm_length"] * radial + x * (sympy.sin(alpha) * across + sympy.cos(alpha) * up)
    energy = place.diff(T).dot(place.diff(T)) / 2 - lift.dot(place)
    rod = sympy.integrate(sympy.expand(energy), (x, 0, p["pendulum_length"]))
    total = p["pendulum_mass"] / p["pendulum_length"] * rod
    total += p["tip_mass"] * energy.subs(x, p["pendulum_length"])
    arm_mass = 3 * p["arm_inertia"] / p["arm_length"] ** 2
    total += p["arm_inertia"] * theta.diff(T) ** 2 / 2 - p["cable_stiffness"] * theta**2 / 2
    total -= arm_mass * lift.dot(radial * p["arm_length"] / 2)
    current = (u - p["motor_constant"] * theta.diff(T)) / p["resistance"]
    forces = [
        p["motor_constant"] * current - p["viscous_1"] * theta.diff(T),
        -p["viscous_2"] * alpha.diff(T),
    ]
    return euler_lagrange(total, forces)


def double_equations(gear=-6.0):
    """Two bodies with centres off their axes, a rotor on the second joint; returns equations and lumped parameters."""
    m1, m2, r1, r2, i1, i2, l1, rotor = 0.56, 0.6, 0.21, 0.15, 0.012, 0.006, 0.3, 6e-5
    first, second = Q[0], Q[0] + Q[1]

    def at(length, angle):
        return length * sympy.Matrix([sympy.sin(angle), -sympy.cos(angle)])

    places = [at(r1, first), at(l1, first) + at(r2, second)]
    lagrangian = i1 * first.diff(T) ** 2 / 2 + i2 * second.diff(T) ** 2 / 2
    for mass, place in zip((m1, m2), places, strict=True):
        lagrangian += mass * (place.diff(T).dot(place.diff(T)) / 2 - 9.81 * place[1])
    lagrangian += rotor * (Q[0].diff(T) + gear * Q[1].diff(T)) ** 2 / 2
    lumped = {
        "inertia_1": i1 + m1 * r1**2 + m2 * l1**2 + rotor,
        "inertia_2": i2 + m2 * r2**2,
        "gravity_torque_1": (m1 * r1 + m2 * l1) * 9.81,
        "gravity_torque_2": m2 * r2 * 9.81,
        "length_1": l1,
        "rotor": gear**2 * rotor,
        "rotor_coupling": gear * rotor,
        "viscous_1": 0.03,
        "viscous_2": 0.01,
    }
    u = sympy.symbols("u1 u2")
    forces = [u[0] - 0.03 * Q[0].diff(T), u[1] - 0.01 * Q[1].diff(T)]
    return euler_lagrange(lagrangian, forces), lumped


FURUTA = nominal("furuta_pendulum", tip_mass=0.004, gravity_x=0.3, gravity_y=-0.2, cable_stiffness=8e-4)
FURUTA_EQUATIONS = furuta_equations(FURUTA)
DOUBLE_EQUATIONS, DOUBLE = double_equations()


def accelerations(name, values, state, drive):
    system = make_system(name)
    scalars = [torch.tensor(v, dtype=torch.float64) for v in state]
    efforts = tuple(torch.tensor(v, dtype=torch.float64) for v in drive[: len(system.commands)])
    law = system.accelerations({n: torch.tensor(v, dtype=torch.float64) for n, v in values.items()})
    return [float(a) for a in law(Motion(tuple(scalars[:2]), tuple(scalars[2:]), efforts))]


@settings(max_examples=40, deadline=None)
@given(angles=st.tuples(ANGLE, ANGLE), speeds=st.tuples(SPEED, SPEED), drive=DRIVE)
def test_the_furuta_pendulum_obeys_its_lagrangian(angles, speeds, drive):
    state = (*angles, *speeds)
    expected = solved(FURUTA_EQUATIONS, state, drive)
    np.testing.assert_allclose(
        accelerations("furuta_pendulum", FURUTA, state, drive), expected, rtol=1e-8, atol=1e-7
    )


@settings(max_examples=40, deadline=None)
@given(angles=st.tuples(ANGLE, ANGLE), speeds=st.tuples(SPEED, SPEED), drive=DRIVE)
def test_the_double_pendulum_obeys_its_lagrangian(angles, speeds, drive):
    state = (*angles, *speeds)
    expected = solved(DOUBLE_EQUATIONS, state, drive)
    np.testing.assert_allclose(
        accelerations("double_pendulum", DOUBLE, state, drive), expected, rtol=1e-8, atol=1e-7
    )


@pytest.mark.parametrize("name", ["furuta_pendulum", "double_pendulum"])
def test_energy_is_kept_without_friction_and_drive(name):
    system = make_system(name)
    p = system.default_parameters()
    for free in ("viscous_1", "viscous_2", "motor_constant"):
        if free in p:
            p[free] = torch.zeros((), dtype=torch.float64)
    state = torch.tensor([0.4, 0.9, 2.0, -3.0], dtype=torch.float64)
    effort = system.effort_of(torch.zeros(len(system.commands), dtype=torch.float64))
    before = float(system.energy(state, p))
    for _ in range(1000):
        state = rk4_step(system, state, effort, 1e-3, p)
    assert float(system.energy(state, p)) == pytest.approx(before, rel=1e-8)


@pytest.mark.parametrize("name", ["furuta_pendulum", "double_pendulum"])
def test_a_length_and_its_inverse_cancel_and_effects_reach_the_right_joint(name):
    system = make_system(name)
    p = system.default_parameters()
    for joint in (0, 1):
        there = system.with_length(torch.tensor(1.3), joint, p)
        back = system.with_length(torch.tensor(1 / 1.3), joint, there)
        assert all(float(back[n]) == pytest.approx(float(p[n]), rel=1e-6) for n in p)
        assert any(float(there[n]) != float(p[n]) for n in p)
    dry = ExtendedSystem(system, ("coulomb(joint 2)",), {"coulomb(joint 2).torque": 0.01})
    at = Motion(*[tuple(torch.tensor([0.0, v], dtype=torch.float64)) for v in (0.3, 5.0)], ())
    drive = tuple(torch.zeros((), dtype=torch.float64) for _ in system.commands)
    plain, slowed = (
        s.accelerations(s.default_parameters())(at._replace(efforts=drive)) for s in (system, dry)
    )
    assert float(slowed[1]) < float(plain[1])


def test_the_rod_is_drawn_on_the_side_to_which_it_leans():
    system = make_system("furuta_pendulum")
    upright, leaning = (
        system.draw(np.array([0.0, alpha, 0.0, 0.0]), np.zeros(1), 64) for alpha in (0.0, 1.2)
    )
    background = upright[0, 0].astype(int)
    assert (np.abs(upright[:16] - background) > 30).any()
    assert not (np.abs(leaning[:16] - background) > 30).any()
