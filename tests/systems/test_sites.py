"""Effects at joints, commands and channels: names, null values, loads in lanes, and hand-worked equations."""

import pickle

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems import SYSTEMS, ExtendedSystem, MemoryEffectError, Motion, make_system
from deepkoco.systems.effects import EFFECTS, effects_of


def scalar(value: float) -> torch.Tensor:
    return torch.tensor(value, dtype=torch.float64)


def test_effects_are_named_by_joint_and_by_channel():
    arm = effects_of(make_system("two_link_arm"))
    assert {
        "coulomb(joint 1)",
        "coulomb(joint 2)",
        "gain(joint 2)",
        "noise_level(speed_2)",
        "payload",
    } <= set(arm)
    height = effects_of(make_system("quadrotor_height"))
    assert "gain" in height
    # A flying body has no dry friction, thrust has one sign, and nothing turns.
    rubs = {"coulomb", "stribeck", "load_friction", "asymmetric_viscous"}
    assert not (rubs | {"dead_zone", "asymmetry", "cogging", "tilt", "torque_speed_curve"}) & set(height)


@settings(max_examples=30, deadline=None)
@given(name=st.sampled_from(sorted(SYSTEMS)), seed=st.integers(0, 10**6))
def test_every_effect_at_its_null_value_changes_nothing(name, seed):
    rng = np.random.default_rng(seed)
    base = make_system(name)
    system = ExtendedSystem(base, tuple(effects_of(base)))
    p = system.default_parameters()
    state = torch.from_numpy(rng.uniform(-4.0, 4.0, 2 * base.joints))
    efforts = tuple(scalar(rng.uniform(max(c.low, -1.0), c.high)) for c in base.commands)
    motion = Motion(tuple(state[: base.joints]), tuple(state[base.joints :]), efforts, time=scalar(3.0))
    with_all, without = (s.accelerations(p)(motion) for s in (system, base))
    assert all(torch.equal(a, b) for a, b in zip(with_all, without, strict=True))
    assert torch.equal(system.measure_at(state, scalar(7.0), p), base.measure(state, p))
    t = torch.arange(20, dtype=torch.float64)
    for k, command in enumerate(base.commands):
        given = torch.from_numpy(rng.uniform(command.low, command.high, (20, 1)))
        assert torch.equal(system.shape_command(k, given, t, p), given)
        timing, plain = system.command_timing(k, p), base.command_timing(k, p)
        assert float(timing.delay) == float(plain.delay)
        assert float(timing.skew) == 0.0
        assert sum(map(float, timing.lag)) == sum(map(float, plain.lag))
    assert float(system.sensor_filter(p)) == 0.0


def test_loads_in_lanes_leave_what_the_caller_gave_alone():
    system = ExtendedSystem(make_system("two_link_arm"), ("coulomb(joint 2)", "viscous(joint 2)"))
    lanes = 5
    p = system.default_parameters()
    p["coulomb(joint 2).torque"] = torch.tensor([0.0, 0.3, 0.3, 0.0, 0.0], dtype=torch.float64)
    p["viscous(joint 2).change"] = torch.tensor([0.0, 0.0, 0.1, 0.2, 0.0], dtype=torch.float64)
    zeros = torch.zeros(3, lanes, dtype=torch.float64)
    outside = torch.full_like(zeros, 0.05)
    motion = Motion((zeros, zeros + 0.4), (zeros + 1.0, zeros - 2.0), (zeros, zeros), (None, outside))
    part = {"coulomb(joint 2)": slice(1, 3), "viscous(joint 2)": slice(2, 4)}
    everywhere = system.accelerations(p)(motion)
    for _ in range(2):  # a load that was changed in place would count twice the second time
        sliced = system.accelerations(p, part)(motion)
        assert all(torch.equal(a, b) for a, b in zip(everywhere, sliced, strict=True))
    assert torch.equal(outside, torch.full_like(zeros, 0.05))


def test_play_follows_only_beyond_its_width():
    system = ExtendedSystem(make_system("rod_pendulum"), ("backlash",), {"backlash.width": 0.2})
    command = torch.tensor([[0.0], [0.5], [0.4], [0.1], [0.25], [-0.3]], dtype=torch.float64)
    t = torch.arange(6, dtype=torch.float64)
    effort = system.shape_command(0, command, t, system.default_parameters())
    # Up to 0.3; 0.4 and 0.1 stay within the play (0.1 + 0.2 = 0.3); -0.3 drags it down to -0.1.
    assert effort.flatten().tolist() == pytest.approx([0.0, 0.3, 0.3, 0.3, 0.3, -0.1])
    with pytest.raises(MemoryEffectError, match="backlash"):
        system.actuate(scalar(1.0), system.default_parameters())


def test_gravity_of_a_tilted_arm_by_hand():
    arm = make_system("two_link_arm")
    system = ExtendedSystem(arm, ("tilt",), {"tilt.gravity_x": 1.0})
    p = system.default_parameters()
    # Both links along y: gravity along x turns the first about the base by -(m1/2 + m2) l1 - m2 l2/2 = -3 N m
    # and the second by -m2 l2/2 = -0.75 N m; the same accelerations come from motors of that torque.
    pose = (scalar(np.pi / 2), scalar(0.0)), (scalar(0.0), scalar(0.0))
    pulled = system.accelerations(p)(Motion(*pose, (scalar(0.0), scalar(0.0))))
    driven = arm.accelerations(p)(Motion(*pose, (scalar(-3.0), scalar(-0.75))))
    assert [float(x) for x in pulled] == pytest.approx([float(x) for x in driven])


def test_a_quadrotor_hovers_at_its_weight():
    height = make_system("quadrotor_height")
    p = height.default_parameters()
    motion = Motion((scalar(1.0),), (scalar(0.0),), (scalar(0.033 * 9.81),))
    assert float(height.accelerations(p)(motion)[0]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_can_be_sent_to_another_process(name):
    assert pickle.loads(pickle.dumps(EFFECTS[name])) == EFFECTS[name]


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_a_system_with_every_effect_computes_the_same_in_another_process(name):
    base = make_system(name)
    system = ExtendedSystem(base, tuple(effects_of(base)))
    back = pickle.loads(pickle.dumps(system))
    assert [e.name for e in back.effects] == [e.name for e in system.effects]
    p = system.default_parameters()
    state = torch.linspace(0.3, 1.1, 2 * base.joints, dtype=torch.float64)
    effort = base.effort_of(torch.full((len(base.commands),), 0.2, dtype=torch.float64))
    assert torch.equal(back.derivative(state, effort, p), system.derivative(state, effort, p))


def test_a_system_with_some_effects_can_be_sent_to_another_process():
    system = ExtendedSystem(make_system("rod_pendulum"), ("coulomb", "lag"), {})
    back = pickle.loads(pickle.dumps(system))
    assert (back.effects, back.parameters) == (system.effects, system.parameters)
