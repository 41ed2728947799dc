"""Accelerations of compiled trees against MuJoCo's own."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deepkoco.systems.motion import Motion
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.actuators import load_actuator
from tests.studied import studied
from tests.systems.trees.random_trees import columns, mujoco_accelerations, random_motions, random_tree


def difference(seed: int, motions: int = 3) -> float:
    """Largest difference from MuJoCo's accelerations, relative to the largest acceleration of the same motion."""
    model, system = random_tree(seed)
    angles, speeds, controls, loads = random_motions(np.random.default_rng(seed), model, motions)
    wanted = mujoco_accelerations(model, angles, speeds, controls, loads)
    parameters = system.default_parameters()
    shaped = tuple(system.shape_command(k, u, u, parameters) for k, u in enumerate(columns(controls)))
    motion = Motion(columns(angles), columns(speeds), shaped, columns(loads))
    found = torch.stack(system.accelerations(parameters)(motion), -1).numpy()
    return float((np.abs(found - wanted).max(-1) / np.abs(wanted).max(-1)).max())


@pytest.mark.parametrize("block", studied(range(10), range(3)))
def test_accelerations_of_200_random_trees_equal_mujoco(block):
    worst = max(difference(seed) for seed in range(20 * block, 20 * block + 20))
    assert worst < 1e-8


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(1000, 2**31))
def test_accelerations_of_any_random_tree_equal_mujoco(seed):
    assert difference(seed, 1) < 1e-8


def motion_of(seed: int, shape: tuple[int, ...], system: TreeSystem, requires_grad: bool = False) -> Motion:
    rng = np.random.default_rng(seed)

    def drawn(count: int, scale: float) -> tuple[torch.Tensor, ...]:
        values = torch.from_numpy(rng.normal(size=(count, *shape)) * scale)
        return tuple(v.requires_grad_() if requires_grad else v for v in values.unbind(0))

    joints = system.joints
    return Motion(
        drawn(joints, 3.0), drawn(joints, 1.0), drawn(len(system.commands), 1.0), drawn(joints, 1.0)
    )


def rubbing(system: TreeSystem, seed: int) -> TreeSystem:
    """The same robot with dry friction at every other joint."""
    joints = [
        replace(joint, frictionloss=0.3 * (k % 2 == seed % 2)) for k, joint in enumerate(system.tree.joints)
    ]
    return TreeSystem(replace(system.tree, joints=tuple(joints)))


def loose(system: TreeSystem) -> TreeSystem:
    """The same robot without damping and springs, its actuators plain loads: nothing in it is stiff."""
    joints = tuple(replace(joint, damping=0.0, stiffness=0.0) for joint in system.tree.joints)
    plain = tuple(load_actuator(joint, j) for j, joint in enumerate(joints))
    return TreeSystem(replace(system.tree, joints=joints, actuators=plain))


@settings(max_examples=25, deadline=None)
@example(seed=21780, lanes=(), shape=(5,))  # a mass matrix of condition 1.5e5
@given(
    seed=st.integers(0, 2**31),
    lanes=st.sampled_from([(), (1,), (5,), (3, 1), (3, 5)]),
    shape=st.sampled_from([(5,), (3, 5), (40, 5)]),
)
def test_compiled_loop_equals_the_torch_path(seed, lanes, shape):
    system = rubbing(random_tree(seed)[1], seed)
    if shape == (40, 5) and lanes[:1] == (3,):
        lanes = lanes[1:]
    rng = np.random.default_rng(seed)
    drawn = {
        p.name: p.value + p.prior_sd * torch.from_numpy(rng.uniform(-0.3, 0.3, lanes))
        for p in system.parameters
    }
    motion = motion_of(seed, shape, system)
    fast = torch.stack(system.accelerations(drawn)(motion))

    def in_torch(off: float) -> torch.Tensor:
        """Accelerations where every parameter is off by a random share of its value."""
        moved = {n: v * (1.0 + off * float(rng.uniform(-1.0, 1.0))) for n, v in drawn.items()}
        with_gradients = {n: v.clone().requires_grad_() for n, v in moved.items()}
        return torch.stack(system.accelerations(with_gradients)(motion)).detach()

    slow = in_torch(0.0)
    assert slow.shape == fast.shape
    largest = slow.abs().amax(0)
    # Some trees are ill-conditioned: two ways to compute may differ by what a rounding of the parameters changes.
    rounded = torch.stack([(in_torch(1e-15) - slow).abs().amax(0) / largest for _ in range(4)]).amax(0)
    assert bool(((fast - slow).abs().amax(0) / largest < 1e-12 + 4.0 * rounded).all())


def test_compiled_loop_is_right_at_angles_of_any_size():
    system = rubbing(random_tree(3)[1], 3)
    motion = motion_of(0, (7,), system)
    far = torch.tensor([0.0, 1e-9, 1e3, -1e4, 9.9e4, 1.1e5, -1e9], dtype=torch.float64)
    motion = motion._replace(angles=tuple(q + far for q in motion.angles))
    parameters = system.default_parameters()
    fast = torch.stack(system.accelerations(parameters)(motion))
    slow = system.accelerations({n: v.requires_grad_() for n, v in parameters.items()})(motion)
    # The angle itself is rounded to 1e-16 of its size.
    bound = 1e-11 + 1e-15 * far.abs()
    difference = (fast - torch.stack(slow).detach()).abs().amax(0) / fast.abs().amax(0)
    assert bool((difference < bound).all())


def test_an_element_that_is_not_finite_leaves_the_others_alone():
    system = random_tree(5)[1]
    motion = motion_of(0, (40,), system)
    whole = torch.stack(system.accelerations(system.default_parameters())(motion))
    motion.angles[0][7], motion.speeds[-1][9] = torch.nan, torch.inf
    broken = torch.stack(system.accelerations(system.default_parameters())(motion))
    kept = torch.ones(40, dtype=torch.bool)
    kept[[7, 9]] = False
    torch.testing.assert_close(broken[:, kept], whole[:, kept], rtol=0.0, atol=0.0)
    assert not torch.isfinite(broken[:, 7]).all()


@pytest.mark.parametrize("seed", [1, 4, 6, 9])
def test_gradients_agree_with_central_differences(seed):
    system = rubbing(random_tree(seed)[1], seed)
    motion = motion_of(seed, (3,), system, requires_grad=True)
    names = [p.name for p in system.parameters]
    values = torch.tensor([p.value for p in system.parameters], dtype=torch.float64, requires_grad=True)
    steps = torch.tensor(
        [1e-5 * max(abs(p.value), p.prior_sd) for p in system.parameters], dtype=torch.float64
    )
    weight = torch.from_numpy(np.random.default_rng(seed).normal(size=(system.joints, 3)))

    def weighted(own: torch.Tensor) -> torch.Tensor:
        """(n,) sums of weighted accelerations under n sets of parameters (n, P)."""
        named = dict(zip(names, own.unsqueeze(-1).unbind(-2), strict=True))
        return (torch.stack(system.accelerations(named)(motion)) * weight[:, None]).sum((0, 2))

    slope = torch.autograd.grad(weighted(values[None]).sum(), values)[0]
    moved = torch.diag(steps)
    with torch.no_grad():
        ahead, behind, twice, back = (weighted(values + f * moved) for f in (1.0, -1.0, 2.0, -2.0))
    difference = (8.0 * (ahead - behind) - (twice - back)) / (12.0 * steps)
    scale = (slope.abs() * steps).max() / steps
    assert float(((slope - difference).abs() / scale).max()) < 1e-6


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_inverse_inertia_equals_mujocos(seed):
    model, system = random_tree(seed)
    system = loose(system)
    data = mujoco.MjData(model)
    angles = np.random.default_rng(seed).normal(size=(3, system.joints))
    motion = Motion(columns(angles), columns(0.0 * angles), columns(0.0 * angles))
    parameters = system.default_parameters()
    fast = system.inverse_inertia(parameters)(motion)
    slow = system.inverse_inertia({n: v.requires_grad_() for n, v in parameters.items()})(motion)
    for i, q in enumerate(angles):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        mass = np.empty((system.joints, system.joints))
        mujoco.mj_fullM(model, data, mass)
        wanted = np.linalg.inv(mass)
        for found in (fast, slow):
            own = np.array([[float(x[i].detach()) for x in row] for row in found])
            assert np.abs(own - wanted).max() < 1e-8 * np.abs(wanted).max()


def test_free_accelerations_leave_out_the_dry_friction_and_nothing_else():
    system = rubbing(loose(random_tree(8)[1]), 0)
    motion, parameters = motion_of(1, (5,), system), system.default_parameters()
    smooth = tuple(torch.full((), 1e-9, dtype=torch.float64) for _ in range(system.joints))
    limits = [0.0 if limit is None else limit for limit in system.dry_friction_limits(parameters)]
    assert any(float(limit) > 0.0 for limit in limits)
    rub = tuple(-limit * torch.sign(v) for limit, v in zip(limits, motion.speeds, strict=True))
    assert motion.loads is not None
    loads = tuple(a + b for a, b in zip(motion.loads, rub, strict=True))
    wanted = system.accelerations(parameters)(motion._replace(smoothing=smooth))
    found = system.free_accelerations(parameters)(motion._replace(loads=loads))
    torch.testing.assert_close(torch.stack(found), torch.stack(wanted), rtol=1e-12, atol=1e-12)


def test_a_motion_of_another_robot_is_refused():
    system = random_tree(4)[1]
    motion = motion_of(0, (3,), system)
    with pytest.raises(ValueError, match="angles, speeds and efforts"):
        system.accelerations(system.default_parameters())(motion._replace(efforts=motion.efforts[:-1]))
