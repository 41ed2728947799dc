"""Lengths, axes, zeros and products of inertia of random trees, against MuJoCo with the edited model."""

import math

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems import Motion
from deepkoco.systems.trees import TreeError, TreeSystem
from deepkoco.systems.trees.compile_tree import compile_tree
from deepkoco.systems.trees.geometry import body_of, geometry_parameters
from deepkoco.systems.trees.settings import TreeSettings
from tests.systems.trees.random_trees import columns, mujoco_accelerations, random_mjcf, random_motions

ARM = """
<mujoco model="arm"><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
    <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0" ref=".2"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .2 0 .1"/></body></body></worldbody></mujoco>
"""


def robot(seed: int):
    text = random_mjcf(np.random.default_rng(seed), 5)
    return text, TreeSystem(compile_tree(mujoco.MjModel.from_xml_string(text), "random"))


def edited(text: str, system: TreeSystem, name: str, value: float) -> mujoco.MjModel | None:
    """MuJoCo's model with the same change; None where bodies without joints lie between."""
    spec, tree = mujoco.MjSpec.from_string(text), system.tree
    kind, owner = name[:-1].split("(")
    if kind == "length":
        joint = next(j for k, j in enumerate(tree.joints) if body_of(tree, k) == owner)
        above = next(b for b in tree.bodies if b.joint == joint.parent)
        body = spec.body(owner)
        if body.parent.name != above.name:
            return None
        offset = np.array(joint.frame.offset)  # in the frame of the joint before
        longer = (value / math.hypot(*offset) - 1.0) * offset
        body.pos = np.array(body.pos) + np.array(above.frame.rotation).T @ longer
    elif kind == "zero":
        spec.joint(owner).ref = value * (1.0 if spec.joint(owner).type == 2 else 180.0 / math.pi)
    elif kind.startswith("axis_"):
        about = np.eye(3)["xyz".index(kind[-1])]
        turn = np.zeros(9)
        quaternion = np.r_[math.cos(value / 2.0), math.sin(value / 2.0) * about]
        mujoco.mju_quat2Mat(turn, quaternion)
        spec.joint(owner).axis = turn.reshape(3, 3) @ np.array(spec.joint(owner).axis)
    else:
        body = next(b for b in tree.bodies if b.name == owner)
        model = mujoco.MjModel.from_xml_string(text)
        welded = sum(model.body_weldid == model.body_weldid[model.body(owner).id])
        if welded > 1:
            return None
        central = np.diag(body.moments)
        i, j = ("xyz".index(c) for c in kind[-2:])
        central[i, j] = central[j, i] = value
        x = np.array(body.axes) @ central @ np.array(body.axes).T
        own = spec.body(owner)
        own.fullinertia = [x[0, 0], x[1, 1], x[2, 2], x[0, 1], x[0, 2], x[1, 2]]
        own.iquat, own.inertia = [1.0, 0.0, 0.0, 0.0], [0.0] * 3
    return spec.compile()


def given_motion(system: TreeSystem, model: mujoco.MjModel, seed: int):
    given = random_motions(np.random.default_rng(seed), model, 2)
    shaped = [system.shape_command(k, u, u, {}) for k, u in enumerate(columns(given[2]))]
    return given, Motion(columns(given[0]), columns(given[1]), tuple(shaped), columns(given[3]))


@pytest.mark.parametrize("kind", ["length", "zero", "axis_", "inertia_"])
@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**31), share=st.floats(-1.0, 1.0))
def test_another_length_axis_zero_or_product_accelerates_as_mujocos_edited_model(kind, seed, share):
    text, system = robot(seed)
    own = [p for p in geometry_parameters(system.tree) if p.name.startswith(kind)]
    if not own:
        return
    p = own[seed % len(own)]
    value = p.value + share * min(p.high - p.value, p.value - p.low)
    model = edited(text, system, p.name, value)
    if model is None:
        return
    given, motion = given_motion(system, model, seed)
    parameters = {**system.default_parameters(), p.name: torch.tensor(value, dtype=torch.float64)}
    found = torch.stack(torch.broadcast_tensors(*system.accelerations(parameters)(motion)), -1).numpy()
    wanted = mujoco_accelerations(model, *given)
    assert (np.abs(found - wanted).max(-1) < 1e-7 * np.abs(wanted).max(-1)).all()


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_candidates_of_a_batch_have_shapes_of_their_own(seed):
    _, system = robot(seed)
    rng = np.random.default_rng(seed)
    own = geometry_parameters(system.tree)
    drawn = {p.name: p.value + p.prior_sd * torch.from_numpy(rng.normal(size=(3, 1))) for p in own}
    model = mujoco.MjModel.from_xml_string(random_mjcf(np.random.default_rng(seed), 5))
    _, motion = given_motion(system, model, seed)
    whole = system.accelerations({**system.default_parameters(), **drawn})(motion)
    for k in range(3):
        alone = {name: value[k] for name, value in drawn.items()}
        one = system.accelerations({**system.default_parameters(), **alone})(motion)
        for a, b in zip(whole, one, strict=True):
            assert torch.allclose(a[k], b, rtol=1e-11, atol=1e-11)


def test_nominal_values_of_the_geometry_change_nothing_to_first_order_and_have_gradients():
    system = TreeSystem(compile_tree(mujoco.MjModel.from_xml_string(ARM), "arm"))
    values = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in geometry_parameters(system.tree)}
    values = {name: value.requires_grad_() for name, value in values.items()}
    motion = Motion(*(tuple(torch.tensor(x, dtype=torch.float64) for x in (a, -a)) for a in (0.3, 0.7, 0.1)))
    found = system.accelerations({**system.default_parameters(), **values})(motion)
    wanted = system.accelerations(system.default_parameters())(motion)
    for a, b in zip(found, wanted, strict=True):
        np.testing.assert_allclose(a.item(), b.item(), rtol=1e-12)
    sum(found).backward()
    assert all(v.grad is not None and bool(torch.isfinite(v.grad)) for v in values.values())
    assert values["length(fore)"].grad.abs() > 1e-3


def settled(tmp_path, text: str) -> TreeSystem:
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "arm.parameters.yaml").write_text(text)
    return TreeSystem.from_file(tmp_path / "arm.xml")


def test_geometry_is_fixed_until_its_kind_is_named(tmp_path):
    text = 'parameters:\n  "length(*)": {prior_sd: 0.003}\n  zero(elbow): 0.25\n'
    freed = {p.name: p for p in settled(tmp_path, text).parameters}
    assert {"length(fore)", "zero(elbow)"} <= set(freed)
    assert (freed["length(fore)"].value, freed["length(fore)"].prior_sd) == (0.3, 0.003)
    assert freed["zero(elbow)"].value == 0.25
    others = settled(tmp_path, 'parameters:\n  "*(fore)": {prior_sd: 0.01}\n').parameters
    assert not any(p.name.startswith(("length", "zero", "axis", "inertia_x")) for p in others)


def test_a_length_that_the_robot_does_not_have_is_refused_by_name(tmp_path):
    with pytest.raises(TreeError, match='no parameter "length\\(upper\\)"'):
        settled(tmp_path, "parameters:\n  length(upper): 0.2\n")
    assert TreeSettings({}).parameters((), ()) == ()
