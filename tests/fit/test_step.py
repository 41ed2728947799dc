"""Integration steps of joints that dry friction slows down, holds and releases, against motions in closed form."""

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.simulate.equations import Equations
from deepkoco.fit.simulate.step import Drive, corrected, directions, replaced, step_of, turning
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.dry_friction import DryFriction
from deepkoco.systems.effects import effects_of
from tests.systems.cart_pole import CartPole, cart_pole_log

MASS, FRICTION, H = 0.8, 0.7, 0.01
NONE = (None,)


def row(*values):
    return (torch.tensor(values, dtype=torch.float64)[:, None],)


def driven(forces, windows):
    time = torch.zeros(windows, 1, dtype=torch.float64)
    (start, end) = (torch.full((windows, 1), f, dtype=torch.float64) for f in forces)
    return Drive(((start,), (0.5 * (start + end),), (end,)), (time, time + 0.5 * H, time + H), None)


def block(friction=FRICTION, stiffness=0.0):
    """A mass on a spring under a force, with dry friction."""

    def law(motion):
        load = 0.0 if motion.loads is None or motion.loads[0] is None else motion.loads[0]
        return ((motion.efforts[0] + load - stiffness * motion.angles[0]) / MASS,)

    level = torch.tensor(friction, dtype=torch.float64)
    inverse = torch.tensor(1.0 / MASS, dtype=torch.float64)
    return Equations(law, DryFriction((level,), (0,)), lambda _: ((inverse,),), row(1.0))


def whole_step(equations, angle, speed, drive, rest=NONE):
    direction = directions(speed, rest, equations.friction)
    step = step_of(equations, angle, speed, drive, direction, H)
    rows = turning(equations, angle, speed, drive, step)
    if len(rows) == 0:
        return step
    assert len(rows) == len(speed[0])
    return corrected(equations, step, angle, speed, drive, direction, H)


def exact(speed, force):
    """Position and speed after a step from position 0 under a constant force."""
    if speed < 0.0:
        place, after = exact(-speed, -force)
        return -place, -after
    braking = (force - FRICTION) / MASS
    if speed == 0.0 or speed + braking * H < 0.0:
        until = -speed / braking if speed else 0.0
        place, left = 0.5 * speed * until, H - until
        back = np.sign(force) * max(abs(force) - FRICTION, 0.0) / MASS
        return place + 0.5 * back * left**2, back * left
    return speed * H + 0.5 * braking * H**2, speed + braking * H


@settings(deadline=None)
@given(speed=st.floats(-0.05, 0.05) | st.just(0.0), force=st.floats(-4.0, 4.0))
def test_step_slides_rests_turns_and_leaves_as_in_closed_form(speed, force):
    step = whole_step(block(), row(0.0), row(speed), driven((force, force), 1))
    place, after = exact(speed, force)
    assert float(step.angle[0]) == pytest.approx(place, abs=1e-12)
    assert float(step.speed[0]) == pytest.approx(after, abs=1e-12)


@settings(deadline=None)
@given(force=st.floats(-1.0, 1.0), slope=st.floats(-20.0, 20.0))
def test_joint_at_rest_does_not_move_while_friction_can_hold_it(force, slope):
    drive = driven((force * FRICTION, np.clip(force * FRICTION + slope * H, -FRICTION, FRICTION)), 1)
    equations = block()
    angle, speed, rest = row(0.3), row(0.0), NONE
    for _ in range(5):
        step = whole_step(equations, angle, speed, drive, rest)
        angle, speed, rest = step.angle, step.speed, step.rest
    assert float(angle[0]) == 0.3
    assert float(speed[0]) == 0.0


@settings(deadline=None)
@given(force=st.floats(-4.0, 4.0), stiffness=st.floats(0.0, 300.0), place=st.floats(-0.02, 0.02))
def test_step_is_continuous_where_the_speed_at_its_start_changes_sign(force, stiffness, place):
    equations, drive = block(stiffness=stiffness), driven((force, force), 1)
    before, after = (whole_step(equations, row(place), row(speed), drive) for speed in (-1e-9, 1e-9))
    assert float(before.angle[0]) == pytest.approx(float(after.angle[0]), abs=1e-8)
    assert float(before.speed[0]) == pytest.approx(float(after.speed[0]), abs=1e-7)


@settings(deadline=None)
@given(speed=st.floats(-0.05, 0.05), force=st.floats(-4.0, 4.0), friction=st.floats(0.0, 2.0))
def test_step_is_continuous_in_the_level_of_friction(speed, force, friction):
    drive = driven((force, force), 1)
    less, more = (whole_step(block(f), row(0.0), row(speed), drive) for f in (friction, friction + 1e-7))
    assert float(less.angle[0]) == pytest.approx(float(more.angle[0]), abs=1e-9)
    assert float(less.speed[0]) == pytest.approx(float(more.speed[0]), abs=1e-8)


def grown(share, breakaway=0.0):
    """A mass whose friction is a share of the force's size, and more near standstill."""

    def varying(motion, _):
        fast = (motion.speeds[0] / 1e-3) ** 2
        return (share * motion.efforts[0].abs() + breakaway * torch.exp(-fast),)

    law = block(0.0)
    return law._replace(friction=DryFriction((torch.zeros((), dtype=torch.float64),), (0,), varying))


@settings(deadline=None)
@given(speed=st.floats(1e-4, 0.03), force=st.floats(3.0, 20.0), nudge=st.floats(-1e-15, 1e-15))
def test_a_force_that_changes_its_sign_while_its_joint_turns_leaves_no_jump(speed, force, nudge):
    """In the middle of the step the friction is 0 but for rounding, at its ends it is not."""
    equations = grown(0.3)
    drive = driven((-force, force - 0.5), 1)
    (start,), _, (end,) = drive.efforts
    steps = [
        whole_step(equations, row(0.0), row(speed), drive._replace(efforts=((start,), (middle,), (end,))))
        for middle in (torch.full((1, 1), x, dtype=torch.float64) for x in (0.0, nudge, 1e-14))
    ]
    ends = [float(step.speed[0]) for step in steps]
    assert ends == pytest.approx([ends[0]] * 3, abs=1e-12)
    # Never faster than without friction, nor beyond what the largest friction does.
    free = (0.0 - 0.25 / 3.0) * H / MASS
    assert abs(ends[0] - speed - free) < 0.3 * force * H / MASS + 1e-9


@settings(deadline=None)
@given(speed=st.floats(1e-3, 0.05), force=st.floats(-8.0, -4.0))
@example(speed=0.017981265527561824, force=-4.484375)
def test_a_joint_that_turns_fast_hardly_feels_a_friction_that_acts_near_standstill_alone(speed, force):
    step = whole_step(grown(0.0, 2.0), row(0.0), row(speed), driven((force, force), 1))
    after = float(step.speed[0])
    assert speed + (force - 2.0) / MASS * H <= after <= speed + (force + 2.0) / MASS * H


def test_corrected_windows_leave_the_others_as_they_are():
    before, drive, equations = row(0.5, 0.01, -0.5), driven((-3.0, -3.0), 3), block()
    direction = directions(before, NONE, equations.friction)
    whole = step_of(equations, row(0.0, 0.0, 0.0), before, drive, direction, H)
    rows = turning(equations, row(0.0, 0.0, 0.0), before, drive, whole)
    assert rows.tolist() == [1]
    part = whole_step(equations, row(0.0), row(0.01), drive.rows(rows))
    step = replaced(whole, rows, part)
    assert torch.equal(step.speed[0][[0, 2]], whole.speed[0][[0, 2]])
    assert torch.equal(step.speed[0][1], part.speed[0][0])


def test_friction_below_zero_drives_a_moving_joint():
    # A fit passes through such values: the speed after a step stays linear in the level.
    speeds = [
        float(whole_step(block(f), row(0.0), row(0.4), driven((0.0, 0.0), 1)).speed[0]) for f in (-1, 0, 1)
    ]
    assert speeds[0] - speeds[1] == pytest.approx(speeds[1] - speeds[2], rel=1e-9)
    assert speeds[0] > speeds[1]


def test_dry_friction_scales_have_the_unit_of_the_joint():
    cart, arm = CartPole(), make_system("two_link_arm")
    assert arm.smoothing_speeds == (0.05, 0.05)
    assert cart.smoothing_speeds[0] < 0.01 * cart.smoothing_speeds[1]
    known = effects_of(cart)
    for joint, (name, unit) in enumerate((("cart", "m/s"), ("pole", "rad/s"))):
        (speed,) = (p for p in known[f"stribeck({name})"].parameters(cart) if p.name == "speed")
        assert speed.unit == unit
        assert speed.low == cart.smoothing_speeds[joint]


def test_predict_of_mixed_dry_friction_lanes_equals_single_lanes():
    cart = CartPole()
    windows = cut_windows([cart_pole_log(0.7, 0, 3.0)], cart, 1.0)
    names = ("coulomb(cart)", "viscous(cart)", "stribeck(cart)", "load_friction(cart)")
    problem = FitProblem(ExtendedSystem(cart, names), windows)
    theta = np.tile([p.value for p in problem.system.parameters], (5, 1))
    pushes = np.zeros((5, len(problem.names) - theta.shape[1]))
    column = problem.names.index
    theta[1, column("coulomb(cart).torque")] = 0.5
    theta[2, column("viscous(cart).change")] = 0.3
    theta[3, column("stribeck(cart).coulomb")] = 0.2
    theta[4, column("load_friction(cart).coefficient")] = 0.3
    theta = np.hstack([theta, pushes])
    state = windows.state[None].repeat(5, 1, 1)
    nuisance = torch.zeros(5, problem.nuisances.count, dtype=torch.float64)
    together = problem.predict(theta, state, nuisance)
    for k in range(5):
        alone = problem.predict(theta[k : k + 1], state[k : k + 1], nuisance[k : k + 1])
        assert float((together[k] - alone[0]).abs().max()) < 1e-9
    apart = (together[:, None] - together[None]).abs().amax((2, 3, 4)) + torch.eye(5)
    assert float(apart.min()) > 1e-3
