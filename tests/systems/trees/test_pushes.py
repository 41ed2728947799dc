"""Pushes at bodies: the loads of 1 N at a point of a link, against MuJoCo's Jacobian."""

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems.motion import POINT
from deepkoco.systems.parameter import ParameterError
from deepkoco.systems.registry import make_system
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.compile_tree import compile_tree
from deepkoco.systems.trees.place_parameters import sideways
from deepkoco.systems.trees.places import body_places, link_line
from tests.systems.trees.random_trees import columns, random_mjcf, random_motions


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), at=st.tuples(*[st.floats(-0.3, 0.5)] * 3))
def test_a_push_loads_every_joint_between_the_point_and_the_base(seed, at):
    model = mujoco.MjModel.from_xml_string(random_mjcf(np.random.default_rng(seed), 5))
    system = TreeSystem(compile_tree(model, "random"))
    data, (angles, *_) = mujoco.MjData(model), random_motions(np.random.default_rng(seed), model, 3)
    for index, place in enumerate(system.push_places):
        given = torch.tensor(at, dtype=torch.float64)[:, None].expand(3, 3)
        found = system.loads_of_push(index, given, columns(angles)).numpy()  # (3, J, n)
        body = model.body(place.body).id
        (site,) = [s for s in body_places(system.tree) if s.name == place.body]
        directions = {"along": link_line(system.tree, site)[0], **dict(sideways(system.tree, site))}
        moved = [n for n in POINT if any(p.name == n for p in place.parameters)]
        point = np.array(site.offset) + sum(at[POINT.index(n)] * directions[n] for n in moved)
        for n, q in enumerate(angles):
            data.qpos[:] = q
            mujoco.mj_forward(model, data)
            # The point is in the frame of the joint, which need not be that of the body.
            welded = [b for b in range(model.nbody) if model.body_weldid[b] == model.body_weldid[body]]
            centre = model.body_mass[welded] @ data.xipos[welded] / model.body_mass[welded].sum()
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jac(model, data, jacobian, None, centre, body)
            if moved:
                frame = _frame_of(system, model, data, place.joint)
                centre = centre + frame @ (point - np.array(site.offset))
                mujoco.mj_jac(model, data, jacobian, None, centre, body)
            np.testing.assert_allclose(found[:, :, n], jacobian, atol=1e-9)


def _frame_of(system, model, data, joint):
    """Rotation of a joint's frame, whose z axis is the joint's, in the world."""
    rotation, chain = np.eye(3), []
    while joint >= 0:
        chain.append(joint)
        joint = system.tree.joints[joint].parent
    for k in reversed(chain):
        own = system.tree.joints[k]
        moved = 0.0 if own.slides else data.qpos[k] - own.reference
        c, s = np.cos(moved), np.sin(moved)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        rotation = rotation @ np.array(own.frame.rotation) @ turn
    return rotation


ARM = """
<mujoco model="arm"><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
    <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .2 0 0"/></body></body>
</worldbody></mujoco>
"""


def test_a_body_that_a_push_moves_in_one_joint_only_is_no_place_of_its_own():
    arm = TreeSystem(compile_tree(mujoco.MjModel.from_xml_string(ARM), "arm"))
    (place,) = arm.push_places
    assert (place.body, place.joint) == ("fore", 1)
    # A force along the axes loads nothing, and no joint turns a point beside the link.
    assert [p.name for p in place.parameters] == ["x", "z", "along", "across"]
    unit = min(arm.load_scales[0] / 0.4, arm.load_scales[1] / 0.1)
    assert place.parameters[0].prior_sd == pytest.approx(unit, rel=0.05)


def test_a_system_in_words_has_no_place_for_a_push():
    pendulum = make_system("pendulum")
    assert pendulum.push_places == ()
    with pytest.raises(ParameterError, match="define its push_places"):
        pendulum.loads_of_push(0, torch.zeros(3, 1), (torch.zeros(1),))


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_coordinates_of_a_pushed_point_are_square_to_each_other(seed):
    tree = compile_tree(mujoco.MjModel.from_xml_string(random_mjcf(np.random.default_rng(seed), 5)), "random")
    for site in body_places(tree):
        line, length = link_line(tree, site)
        ways = np.array([*([line] if length > 0.0 else []), *(way for _, way in sideways(tree, site))])
        np.testing.assert_allclose(ways @ ways.T, np.eye(len(ways)), atol=1e-12)


def test_a_link_is_as_thick_as_a_cylinder_of_its_inertia():
    arm = TreeSystem(compile_tree(mujoco.MjModel.from_xml_string(ARM.replace("capsule", "cylinder")), "arm"))
    (place,) = arm.push_places
    across = {p.name: p for p in place.parameters}["across"]
    assert across.prior_sd == pytest.approx(0.02)
