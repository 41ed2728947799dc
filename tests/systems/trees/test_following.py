"""Joints that follow others: the whole robot with its couplings kept, against MuJoCo's inertia matrix."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems import ExtendedSystem, Motion, load_system
from deepkoco.systems.model_yaml import save_model
from deepkoco.systems.trees import TreeError, TreeSystem
from deepkoco.systems.trees.compile_tree import compile_tree
from deepkoco.systems.trees.following import FollowingSystem
from deepkoco.systems.trees.held_joints import Follower, followers, hold_joints
from deepkoco.systems.trees.write_back import extended_mjcf
from tests.systems.trees.random_trees import random_mjcf

LINKAGE = """<robot name="linkage"><link name="base"/>
  <link name="crank">{bar}</link><link name="rocker">{bar}</link><link name="coupler">{coupler}</link>
  <joint name="crank" type="revolute"><parent link="base"/><child link="crank"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="20" velocity="20"/><dynamics damping="0.4"/></joint>
  <joint name="rocker" type="revolute"><parent link="base"/><child link="rocker"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="20" velocity="20"/><mimic joint="crank"/></joint>
  <joint name="coupler" type="revolute"><parent link="crank"/><child link="coupler"/><origin xyz="0 0 -0.3"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="20" velocity="20"/>
    <mimic joint="crank" multiplier="-1" offset="0.2"/></joint></robot>"""
INERTIA = (
    '<inertial><origin xyz="{at}"/><mass value="{mass}"/>'
    '<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def column(values):
    return tuple(torch.tensor([float(value)], dtype=torch.float64) for value in values)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), ratio=st.sampled_from([-2.0, -1.0, 0.5, 1.0]), data=st.data())
def test_a_coupled_tree_moves_as_its_projected_equations(seed, ratio, data):
    model = mujoco.MjModel.from_xml_string(random_mjcf(np.random.default_rng(seed)))
    if model.njnt < 3:
        return
    f, leader = data.draw(st.permutations(range(model.njnt)))[:2]
    names = [model.joint(j).name for j in range(model.njnt)]
    tree = compile_tree(model, "robot")
    tree = replace(tree, actuators=tuple(a for a in tree.actuators if a.joint != f))
    if not tree.actuators:
        return
    system = FollowingSystem(TreeSystem(tree), [Follower(names[f], names[leader], 0.3, ratio)])
    assert system.joint_names == tuple(n for j, n in enumerate(names) if j != f)

    rng = np.random.default_rng(seed)
    state = mujoco.MjData(model)
    angles, speeds = rng.normal(size=model.njnt), rng.normal(size=model.njnt)
    reference = model.qpos0
    angles[f] = reference[f] + 0.3 + ratio * (angles[leader] - reference[leader])
    speeds[f] = ratio * speeds[leader]
    state.qpos[:], state.qvel[:] = angles, speeds
    mujoco.mj_forward(model, state)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, state, mass)
    actuated = state.qfrc_actuator.copy()
    actuated[f] = 0.0
    load = state.qfrc_passive + actuated - state.qfrc_bias
    free = [j for j in range(model.njnt) if j != f]
    tie = np.eye(model.njnt)[:, free]
    tie[f, free.index(leader)] = ratio
    wanted = np.linalg.solve(tie.T @ mass @ tie, tie.T @ load)

    p = {
        n: torch.zeros_like(v) if n.startswith("frictionloss") else v
        for n, v in system.default_parameters().items()
    }
    none = column([0.0] * len(system.commands))
    efforts = tuple(system.shape_command(k, u, u, p) for k, u in enumerate(none))
    motion = Motion(column(angles[free]), column(speeds[free]), efforts, column([0.0] * len(free)))
    found = torch.stack(system.accelerations(p)(motion), -1)[0].numpy()
    assert found == pytest.approx(wanted, rel=1e-6, abs=1e-6 * np.abs(wanted).max())


@pytest.fixture
def linkage(tmp_path: Path):
    def read(coupler: float):
        bar = INERTIA.format(at="0 0 -0.15", mass=0.6, i=0.006)
        (tmp_path / "linkage.urdf").write_text(
            LINKAGE.format(bar=bar, coupler=INERTIA.format(at="0.2 0 0", mass=coupler, i=0.01))
        )
        return load_system(str(tmp_path / "linkage.urdf"))

    return read


def test_a_parallel_linkage_has_the_inertia_and_the_weight_of_all_its_bars(linkage):
    system = linkage(1.0)
    assert system.joint_names == ("crank",)
    assert [c.name for c in system.commands] == ["crank"]
    assert "damping(coupler)" not in [p.name for p in system.parameters]
    # Two bars of 0.6 kg turn about their ends, and 1 kg moves on a circle of 0.3 m without turning.
    inertia = 2.0 * (0.006 + 0.6 * 0.15**2) + 1.0 * 0.3**2
    torque = 1.3 - 9.81 * (2.0 * 0.6 * 0.15 + 1.0 * 0.3) * np.sin(0.4) - 0.4 * 0.7
    motion = Motion(column([0.4]), column([0.7]), column([1.3]))
    (found,) = system.accelerations(system.default_parameters())(motion)
    assert float(found) == pytest.approx(torque / inertia, rel=1e-9)
    # A payload in the coupler adds its mass alone.
    more = system.with_payload_at(
        "coupler", torch.tensor(0.5, dtype=torch.float64), system.default_parameters()
    )
    (found,) = system.accelerations(more)(motion)
    loaded = (torque - 9.81 * 0.5 * 0.3 * np.sin(0.4)) / (inertia + 0.5 * 0.3**2)
    assert float(found) == pytest.approx(loaded, rel=1e-9)


def test_a_joint_that_follows_with_little_mass_is_held(linkage):
    notes = " ".join(linkage(0.1).notes)
    assert '"coupler" follows "crank" and is held' in notes
    assert '"rocker" follows "crank" and moves with it' in notes


def test_a_linkage_is_not_written_back_and_this_is_said(linkage, tmp_path):
    with pytest.raises(TreeError, match="joints that follow others"):
        extended_mjcf(linkage(1.0), tmp_path)


TWO = """<mujoco><worldbody>
  <body name="a"><joint name="ja" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/>
    <body name="jb" pos=".3 0 0"><joint name="jb" axis="0 1 0"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/></body></body>
  <body name="jc" pos="0 1 0"><joint name="jc" axis="0 1 0"/>
    <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/></body></worldbody>
  <actuator><motor name="m" joint="ja"/></actuator><equality>{equality}</equality></mujoco>"""


def test_a_line_from_the_joint_that_is_driven_is_read_the_other_way():
    spec = mujoco.MjSpec.from_string(
        TWO.format(equality='<joint joint1="ja" joint2="jb" polycoef="0.7 2 0 0 0"/>')
    )
    (found,) = followers(spec, {})
    assert found == Follower("jb", "ja", -0.35, 0.5)


def test_what_couples_bodies_stays_where_joints_of_the_same_name_follow():
    both = '<joint joint1="jb" joint2="ja"/><connect body1="jb" body2="jc" anchor="0 0 0"/>'
    spec = mujoco.MjSpec.from_string(TWO.format(equality=both))
    hold_joints(spec, {}, kept=("jb",))
    assert [e.type for e in spec.equalities] == [mujoco.mjtEq.mjEQ_CONNECT]


def test_a_linkage_can_be_simulated_and_stored(linkage, tmp_path):
    system = linkage(1.0)
    state = torch.tensor([0.4, 0.7], dtype=torch.float64)
    slope = system.derivative(state, torch.tensor(1.3, dtype=torch.float64), system.default_parameters())
    assert slope[0] == 0.7
    save_model(tmp_path / "model.yaml", system)
    stored = load_system(tmp_path / "model.yaml")
    assert isinstance(stored, ExtendedSystem)
    assert isinstance(stored.base, FollowingSystem)
