"""Outside forces and payloads at bodies of random trees, against MuJoCo with the same force or body."""

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems import ExtendedSystem, Motion
from deepkoco.systems.effects import effects_of
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.compile_tree import compile_tree
from tests.systems.trees.random_trees import columns, mujoco_accelerations, random_mjcf, random_motions

GANTRY = """
<mujoco><worldbody>
  <body name="bridge"><joint name="x" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>
    <body name="head" pos="0 0 1"><joint name="z" type="slide" axis="0 0 1"/>
      <inertial pos="0 0 -.3" mass="2" diaginertia=".1 .1 .1"/></body>
  </body></worldbody></mujoco>
"""


def robots(seed: int):
    text = random_mjcf(np.random.default_rng(seed), 5)
    model = mujoco.MjModel.from_xml_string(text)
    return text, model, TreeSystem(compile_tree(model, "random"))


def motion_for(system, model, seed, count=3):
    given = random_motions(np.random.default_rng(seed), model, count)
    shaped = [system.shape_command(k, u, u, {}) for k, u in enumerate(columns(given[2]))]
    return given, Motion(columns(given[0]), columns(given[1]), tuple(shaped), columns(given[3]))


def agrees(found, wanted) -> bool:
    found = torch.stack(torch.broadcast_tensors(*found), -1).detach().numpy()
    return bool((np.abs(found - wanted).max(-1) < 1e-8 * np.abs(wanted).max(-1)).all())


def forced(model, place, force, given):
    """MuJoCo's accelerations with a force of the world at the centre of mass of a body and what is welded to it."""
    angles, speeds, controls, loads = given
    data, pushes = mujoco.MjData(model), []
    body = model.body(place).id
    for q, v in zip(angles, speeds, strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        welded = [b for b in range(model.nbody) if model.body_weldid[b] == model.body_weldid[body]]
        masses = model.body_mass[welded]
        centre = masses @ data.xipos[welded] / masses.sum()
        push = np.zeros(model.nv)
        mujoco.mj_applyFT(model, data, force, np.zeros(3), centre, body, push)
        pushes.append(push)
    return mujoco_accelerations(model, angles, speeds, controls, loads + np.array(pushes))


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), gradients=st.booleans())
def test_a_force_at_a_body_accelerates_as_mujocos(seed, gradients):
    _, model, system = robots(seed)
    rng = np.random.default_rng(seed)
    place, force = str(rng.choice(system.force_sites)), rng.normal(size=3) * 5.0
    given, motion = motion_for(system, model, seed)
    values = {axis: torch.tensor(f, dtype=torch.float64) for axis, f in zip("xyz", force, strict=True)}
    if gradients:
        values = {axis: f.requires_grad_() for axis, f in values.items()}
    found = system.accelerations(system.with_force_at(place, values, system.default_parameters()))(motion)
    assert agrees(found, forced(model, place, force, given))


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_bodies_that_are_held_up_accelerate_as_mujocos(seed):
    spec = mujoco.MjSpec.from_string(random_mjcf(np.random.default_rng(seed), 5))
    for body, share in zip(spec.bodies[1:], np.random.default_rng(seed).uniform(0.0, 1.5, 20), strict=False):
        body.gravcomp = share
    model = spec.compile()
    system = TreeSystem(compile_tree(model, "held"))
    given, motion = motion_for(system, model, seed)
    found = system.accelerations(system.default_parameters())(motion)
    assert agrees(found, mujoco_accelerations(model, *given))


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), share=st.floats(0.0, 1.0))
def test_a_payload_along_a_link_accelerates_as_a_body_there(seed, share):
    text, model, system = robots(seed)
    places = [site for site in system.payload_sites if system.payload_way(site) is not None]
    if not places:
        return
    place = str(np.random.default_rng(seed).choice(places))
    way = system.payload_way(place)
    along = way.low + share * (way.high - way.low)
    site = next(s for s in system.tree.sites if s.name == place)
    body = next(b for b in system.tree.bodies if b.name == place)
    ends = [np.array(j.frame.offset) for j in system.tree.joints if j.parent == site.joint]
    ends += [np.array(s.offset) for s in system.tree.sites if s.joint == site.joint]
    end = max(ends, key=lambda x: float(np.linalg.norm(x)))
    direction = end / np.linalg.norm(end)
    point = np.array(site.offset) + (along - way.at) * direction
    assert np.isclose(direction @ point, along)
    spec = mujoco.MjSpec.from_string(text)
    rotation = np.array(body.frame.rotation)
    added = spec.body(place).add_body(pos=rotation.T @ (point - np.array(body.frame.offset)))
    added.explicitinertial, added.mass, added.inertia, added.ipos = True, 0.7, [1e-12] * 3, [0.0] * 3
    heavier = spec.compile()
    given, motion = motion_for(system, model, seed)
    given = (*given[:2], given[2][:, : heavier.nu or heavier.nv], given[3])
    scalar = {k: torch.tensor(v, dtype=torch.float64) for k, v in {"mass": 0.7, "along": along}.items()}
    effect = next(
        p for p in effects_of(system).values() if p.effect.name == "payload" and _place(p, system) == place
    )
    parameters = effect.effect.apply(system, effect.index, system.default_parameters(), scalar)
    assert agrees(system.accelerations(parameters)(motion), mujoco_accelerations(heavier, *given))


def _place(placed, system) -> str:
    return system.tip if placed.index == 0 else system.payload_sites[placed.index - 1]


@pytest.mark.parametrize("batch", [(3, 1), (1, 4)])
def test_forces_differ_between_candidates_and_spare_those_without_any(batch):
    _, model, system = robots(5)
    _, motion = motion_for(system, model, 5, 4)
    place = system.force_sites[-1]
    parameters = system.default_parameters()
    force = torch.arange(float(np.prod(batch)), dtype=torch.float64).reshape(batch)  # the first is 0
    found = system.accelerations(system.with_force_at(place, {"z": force}, parameters))(motion)
    for k, own in enumerate(force.expand(3, 4).reshape(-1)):
        alone = system.accelerations(system.with_force_at(place, {"z": own}, parameters))(motion)
        for whole, one in zip(found, alone, strict=True):
            assert torch.allclose(whole.expand(3, 4)[k // 4, k % 4], one[k % 4], rtol=1e-12, atol=1e-12)
    still = system.accelerations(parameters)(motion)
    assert all(torch.equal(a.expand(3, 4)[0, 0], b[0]) for a, b in zip(found, still, strict=True))


def test_what_no_motion_shows_of_a_force_or_a_place_is_not_offered():
    system = TreeSystem(compile_tree(mujoco.MjModel.from_xml_string(GANTRY), "gantry"))
    effects = effects_of(system)
    assert [p.name for p in effects["force(bridge)"].parameters(system)] == ["x"]
    assert [p.name for p in effects["force(head)"].parameters(system)] == ["x", "z"]
    # Slides carry a payload at any place alike.
    assert [p.name for p in effects["payload"].parameters(system)] == ["mass"]


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_effects_of_bodies_at_their_null_values_change_nothing(seed):
    _, model, system = robots(seed)
    names = tuple(n for n, p in effects_of(system).items() if p.effect.name in ("force", "payload"))
    extended = ExtendedSystem(system, names)
    _, motion = motion_for(system, model, seed)
    found = extended.accelerations(extended.default_parameters())(motion)
    wanted = system.accelerations(system.default_parameters())(motion)
    for a, b in zip(found, wanted, strict=True):
        assert torch.allclose(a, b, rtol=1e-12, atol=0.0)
