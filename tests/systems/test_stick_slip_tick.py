"""One tick of joints that stick: the scheme of a simulation along a log, without branches."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit.simulate.equations import Equations
from deepkoco.fit.simulate.step import Drive, corrected, directions, step_of, turning
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.stick_slip import Joints, StickSlip
from deepkoco.systems.with_speeds import WithSpeeds

BATCH, H = 8, 0.01


def system_with(levels: tuple[float, float], stribeck: bool) -> ExtendedSystem:
    arm = make_system("two_link_arm")
    kinds = ("stribeck.coulomb", "coulomb.torque") if stribeck else ("coulomb.torque",) * 2
    names = [arm.at_joint(kind.split(".")[0], j) for j, kind in enumerate(kinds)]
    values = {f"{n}.{k.split('.')[1]}": v for n, k, v in zip(names, kinds, levels, strict=True)}
    return ExtendedSystem(arm, tuple(names), values)


def along_a_log(system, angle, speed, rest, efforts, ticks):
    """States after each tick, by the simulator of fits."""
    p = system.default_parameters()
    smoothing = tuple(torch.tensor(s, dtype=torch.float64) for s in system.smoothing_speeds)
    friction = system.dry_friction_levels(p)
    equations = Equations(
        system.free_accelerations(p), friction, system.inverse_inertia(p), smoothing, system.joint_memory(p)
    )
    time, states = torch.zeros(BATCH, 1, dtype=torch.float64), []
    for k in range(ticks):
        drive = Drive((efforts[k],) * 3, (time,) * 3, None)
        direction = directions(speed, rest, friction)
        step = step_of(equations, angle, speed, drive, direction, H)
        if len(turning(equations, angle, speed, drive, step)):
            step = corrected(equations, step, angle, speed, drive, direction, H)
        angle, speed, rest = step.angle, step.speed, step.rest
        states.append(torch.cat([*angle, *speed], -1))
    return torch.stack(states)


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 2**31),
    st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 0.6)),
    st.booleans(),
)
def test_tick_is_that_of_the_simulator_of_fits(seed, levels, stribeck):
    system, rng, ticks = system_with(levels, stribeck), np.random.default_rng(seed), 12
    start = torch.from_numpy(rng.uniform(-1.0, 1.0, (4, BATCH))) * torch.tensor([1.0, 1.0, 0.3, 0.3])[:, None]
    start[2:, ::2] = 0.0  # half of them start at rest
    efforts = torch.from_numpy(rng.uniform(-1.5, 1.5, (ticks // 4, 2, BATCH))).repeat_interleave(4, 0)
    none = (torch.zeros(BATCH, 1, dtype=torch.float64),) * 2
    wide = [tuple(u[:, None] for u in tick) for tick in efforts]
    expected = along_a_log(
        system, tuple(x[:, None] for x in start[:2]), tuple(x[:, None] for x in start[2:]), none, wide, ticks
    )
    law = StickSlip(WithSpeeds(system, 50.0), system.default_parameters())
    zero = torch.zeros(BATCH, dtype=torch.float64)
    joints = Joints(tuple(start[:2]), tuple(start[2:]), (zero, zero), ())
    for k in range(ticks):
        joints = law.tick(joints, tuple(efforts[k]), H)
        found = torch.stack([*joints.angles, *joints.speeds], -1)
        # Windows in which nothing turns are not corrected there, and the sweeps end at 1e-7 of an acceleration.
        torch.testing.assert_close(found, expected[k], rtol=0.0, atol=1e-6)


def test_a_joint_stays_exactly_where_friction_can_hold_it():
    system = system_with((0.5, 0.3), False)
    law = StickSlip(system, system.default_parameters())
    angles = tuple(torch.tensor([0.3, -0.7], dtype=torch.float64))
    zero = torch.zeros((), dtype=torch.float64)
    held = law.tick(Joints(angles, (zero, zero), (zero, zero), ()), (zero + 0.2, zero - 0.1), H)
    assert held.angles == angles
    assert held.speeds == (0.0, 0.0)
    # Shares of the level against the motion: the load is minus that, and holds what the actuator does.
    assert [-r * level for r, level in zip(held.rest, (0.5, 0.3), strict=True)] == pytest.approx(
        [-0.2, 0.1], abs=1e-3
    )
    free = law.tick(Joints(angles, (zero, zero), (zero, zero), ()), (zero + 0.9, zero), H)
    assert free.speeds[0] > 0.0


def test_sweeps_that_no_value_ends_agree_with_those_that_settle(monkeypatch):
    system = system_with((0.6, 0.4), True)
    law = StickSlip(system, system.default_parameters())
    rng = np.random.default_rng(3)
    angles, speeds, efforts = (
        tuple(torch.from_numpy(rng.uniform(-s, s, (2, BATCH)))) for s in (1.0, 0.1, 1.0)
    )
    rest = (torch.zeros(BATCH, dtype=torch.float64),) * 2
    settled = law.tick(Joints(angles, speeds, rest, ()), efforts, H)
    for where in ("dry_friction", "stick_slip"):
        monkeypatch.setattr(f"deepkoco.systems.{where}.is_plain", lambda values: False)
    monkeypatch.setattr("deepkoco.systems.dry_friction.is_readable", lambda value: False)
    fixed = law.tick(Joints(angles, speeds, rest, ()), efforts, H)
    for a, b in zip(fixed[:3], settled[:3], strict=True):
        torch.testing.assert_close(torch.stack(a), torch.stack(b), rtol=0.0, atol=1e-6)
