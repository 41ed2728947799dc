"""Integration steps with a reversal under dry friction, against motions in closed form."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.simulate.step import (
    Drive,
    divided,
    replaced,
    reversing,
    sharpest_widths,
    step_of,
    widths,
)
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.effects import effects_of
from tests.systems.cart_pole import CartPole, cart_pole_log

MASS, FRICTION, H, PARTS = 0.8, 0.7, 0.01, 16


def row(*values):
    return (torch.tensor(values, dtype=torch.float64)[:, None],)


def driven(forces, windows):
    time = torch.zeros(windows, 1, dtype=torch.float64)
    (start, end) = (torch.full((windows, 1), f, dtype=torch.float64) for f in forces)
    return Drive(((start,), (0.5 * (start + end),), (end,)), (time, time + 0.5 * H, time + H), None)


def rubbing(motion):
    (speed,), (width,), (force,) = motion.speeds, motion.smoothing, motion.efforts
    return ((force - FRICTION * torch.tanh(speed / width)) / MASS,)


def exact(speed, force):
    """Position and speed after a step from position 0 with a positive speed under a constant force."""
    braking = (force - FRICTION) / MASS
    if speed + braking * H >= 0.0:
        return speed * H + 0.5 * braking * H**2, speed + braking * H
    until = -speed / braking
    place, left = 0.5 * speed * until, H - until
    back = (force + FRICTION) / MASS if force < -FRICTION else 0.0  # it sticks
    return place + 0.5 * back * left**2, back * left


@settings(deadline=None)
@given(speed=st.floats(0.002, 0.05), force=st.floats(-4.0, -1.0))
def test_divided_step_reproduces_a_reversal_under_dry_friction(speed, force):
    (sharpest,) = sharpest_widths(CartPole().smoothing_speeds[:1])
    angle, fast, drive = row(0.0), row(speed), driven((force, force), 1)
    width = widths(row(abs(force - FRICTION) / MASS), (sharpest,), H)
    whole = step_of(rubbing, angle, fast, drive, width, H)
    rows = reversing(fast, whole.speed, width, (PARTS,))
    step = whole
    if len(rows):
        part = divided(rubbing, angle, fast, drive, width, (sharpest,), H, rows, PARTS)
        step = replaced(whole, rows, part)
    place, after = exact(speed, force)
    assert float(step.angle[0]) == pytest.approx(place, abs=3e-6)
    assert float(step.speed[0]) == pytest.approx(after, abs=5e-4)


@settings(deadline=None)
@given(angle=st.floats(-2.0, 2.0), speed=st.floats(-2.0, 2.0), force=st.floats(-1.0, 1.0))
def test_divided_step_equals_the_whole_step_of_a_smooth_motion(angle, speed, force):
    def law(motion):
        return (motion.efforts[0] - torch.sin(motion.angles[0]) - 0.1 * motion.speeds[0],)

    drive, width = driven((force, 0.5 * force), 2), (torch.tensor(0.01, dtype=torch.float64),)
    start, fast = row(angle, 0.0), row(speed, 0.0)
    whole = step_of(law, start, fast, drive, width, H)
    part = divided(law, start, fast, drive, width, (0.01,), H, torch.tensor([0]), PARTS)
    for a, b in zip(part[:3], whole[:3], strict=True):
        assert float(a[0]) == pytest.approx(float(b[0][0]), abs=1e-9)
    # The acceleration at the end comes from the last stage, whose state has a lower order.
    assert float(part.last[0]) == pytest.approx(float(whole.last[0][0]), abs=1e-4)


def test_replaced_changes_only_the_windows_that_reverse():
    width = (torch.tensor(0.001, dtype=torch.float64),)
    before, drive = row(0.5, 0.01, -0.5), driven((-3.0, -3.0), 3)
    whole = step_of(rubbing, row(0.0, 0.0, 0.0), before, drive, width, H)
    rows = reversing(before, whole.speed, width, (PARTS,))
    assert rows.tolist() == [1]
    part = divided(rubbing, row(0.0, 0.0, 0.0), before, drive, width, (0.001,), H, rows, PARTS)
    step = replaced(whole, rows, part)
    assert torch.equal(step.speed[0][[0, 2]], whole.speed[0][[0, 2]])
    assert torch.equal(step.speed[0][1], part.speed[0][0])
    assert len(reversing(before, whole.speed, width, (1,))) == 0


def test_dry_friction_scales_have_the_unit_of_the_joint():
    cart, arm = CartPole(), make_system("two_link_arm")
    assert arm.smoothing_speeds == (0.05, 0.05)
    assert arm.reversal_steps == (1, 1)
    assert cart.smoothing_speeds[0] < 0.01 * cart.smoothing_speeds[1]
    assert cart.reversal_steps[0] > cart.reversal_steps[1] == 1
    assert ExtendedSystem(cart, ("viscous(cart)",)).rubbing_joints == ()
    assert ExtendedSystem(cart, ("viscous(pole)", "coulomb(cart)")).rubbing_joints == (0,)
    known = effects_of(cart)
    for joint, (name, unit) in enumerate((("cart", "m/s"), ("pole", "rad/s"))):
        (speed,) = (p for p in known[f"stribeck({name})"].parameters(cart) if p.name == "speed")
        assert speed.unit == unit
        assert speed.low == cart.smoothing_speeds[joint]


def test_predict_of_mixed_dry_friction_lanes_equals_single_lanes():
    cart = CartPole()
    windows = cut_windows([cart_pole_log(0.7, 0, 3.0)], cart, 1.0)
    names = ("coulomb(cart)", "viscous(cart)", "stribeck(cart)")
    problem = FitProblem(ExtendedSystem(cart, names), windows)
    theta = np.tile([p.value for p in problem.system.parameters], (4, 1))
    pushes = np.zeros((4, len(problem.names) - theta.shape[1]))
    column = problem.names.index
    theta[1, column("coulomb(cart).torque")] = 0.5
    theta[2, column("viscous(cart).change")] = 0.3
    theta[3, column("stribeck(cart).coulomb")] = 0.2
    theta = np.hstack([theta, pushes])
    state = windows.state[None].repeat(4, 1, 1)
    nuisance = torch.zeros(4, problem.nuisances.count, dtype=torch.float64)
    together = problem.predict(theta, state, nuisance)
    for k in range(4):
        alone = problem.predict(theta[k : k + 1], state[k : k + 1], nuisance[k : k + 1])
        assert float((together[k] - alone[0]).abs().max()) < 1e-5
    apart = (together[:, None] - together[None]).abs().amax((2, 3, 4)) + torch.eye(4)
    assert float(apart.min()) > 1e-3
