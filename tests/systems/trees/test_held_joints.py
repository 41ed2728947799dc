"""Joints that are held, couplings of joints, and inertias as files give them."""

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems.motion import Motion
from deepkoco.systems.trees import TreeError, TreeSystem
from deepkoco.systems.trees.compile_tree import compile_tree
from deepkoco.systems.trees.held_joints import hold_joints
from deepkoco.systems.trees.inertias import nearest_inertia
from deepkoco.systems.trees.robot_files import write_robot
from tests.systems.trees.random_trees import random_mjcf

INERTIAL = '<inertial pos="0 0 -.1" mass="{mass}" diaginertia=".01 .02 .015"/>'
GRIPPER = """<mujoco><worldbody><body name="hand"><joint name="wrist" axis="0 1 0"/>{hand}
    <body name="left" pos=".1 0 0"><joint name="left" type="slide" axis="0 1 0" ref="0.01"/>{left}</body>
    <body name="right" pos=".1 0 0"><joint name="right" type="slide" axis="0 -1 0"/>{left}</body></body></worldbody>
    {rest}</mujoco>"""


TENDON = """<tendon><fixed name="split"><joint joint="left" coef=".5"/><joint joint="right" coef=".5"/></fixed>
    </tendon>"""


def gripper(rest=""):
    return GRIPPER.format(hand=INERTIAL.format(mass=1), left=INERTIAL.format(mass=0.2), rest=rest)


def read(tmp_path, text, held=None, name="robot.xml"):
    path = tmp_path / name
    path.write_text(text)
    if held is not None:
        path.with_name(f"{path.stem}.parameters.yaml").write_text(f"held: {held}\n")
    return TreeSystem.from_file(path)


def accelerations(system, angles, speeds):
    """Without commands, (J,)."""

    def column(values):
        return tuple(torch.tensor([value], dtype=torch.float64) for value in values)

    none, parameters = column([0.0] * len(system.commands)), system.default_parameters()
    shaped = tuple(system.shape_command(k, u, u, parameters) for k, u in enumerate(none))
    motion = Motion(column(angles), column(speeds), shaped, column([0.0] * system.joints))
    return torch.stack(system.accelerations(parameters)(motion), -1)[0].numpy()


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), data=st.data())
def test_what_is_left_moves_as_the_whole_robot_whose_held_joints_are_locked(seed, data):
    text = random_mjcf(np.random.default_rng(seed))
    whole = mujoco.MjModel.from_xml_string(text)
    alone = [j for j in range(whole.njnt) if whole.body_jntnum[whole.jnt_bodyid[j]] == 1]
    held = {whole.joint(j).name: data.draw(st.floats(-1.0, 1.0)) for j in alone if data.draw(st.booleans())}
    free = [j for j in range(whole.njnt) if whole.joint(j).name not in held]
    if not held or not free:
        return
    spec = mujoco.MjSpec.from_string(text)
    hold_joints(spec, held)
    left = spec.compile()
    assert [left.joint(j).name for j in range(left.njnt)] == [whole.joint(j).name for j in free]
    rng = np.random.default_rng(seed)
    data_whole, data_left = mujoco.MjData(whole), mujoco.MjData(left)
    for j in range(whole.njnt):
        data_whole.qpos[j] = held.get(whole.joint(j).name, rng.normal())
        data_whole.qvel[j] = 0.0 if j not in free else rng.normal()
    data_left.qpos[:], data_left.qvel[:] = data_whole.qpos[free], data_whole.qvel[free]
    for model, own in ((whole, data_whole), (left, data_left)):
        mujoco.mj_forward(model, own)
    mass = np.zeros((whole.nv, whole.nv))
    mujoco.mj_fullM(whole, data_whole, mass)
    load = data_whole.qfrc_passive + data_whole.qfrc_actuator - data_whole.qfrc_bias
    # Locked joints take any load, so their rows fall out.
    wanted = np.linalg.solve(mass[np.ix_(free, free)], load[free])
    assert data_left.qacc == pytest.approx(wanted, rel=1e-6, abs=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("active", [True, False])
def test_a_joint_that_follows_another_is_held_where_the_coupling_puts_it(tmp_path, active):
    coupling = (
        '<equality><joint joint1="right" joint2="left" polycoef="0.03 1 0 0 0" '
        f'active="{str(active).lower()}"/></equality>'
    )
    system = read(tmp_path, gripper(coupling))
    assert system.joint_names == (("wrist", "left") if active else ("wrist", "left", "right"))
    if not active:
        return
    assert 'the joint "right" follows "left" and is held' in " ".join(system.notes)
    moved = gripper().replace(
        '<body name="right" pos=".1 0 0"><joint name="right" type="slide" axis="0 -1 0"/>',
        '<body name="right" pos=".1 -.03 0">',
    )
    (tmp_path / "other").mkdir()
    by_hand = read(tmp_path / "other", moved)
    state = ([0.3, 0.02], [0.5, -0.1])
    assert accelerations(system, *state) == pytest.approx(accelerations(by_hand, *state), rel=1e-9)


def test_the_joint_with_the_actuator_stays_free_whichever_way_the_coupling_is_written(tmp_path):
    rest = (
        '<equality><joint joint1="left" joint2="right"/></equality>'
        '<actuator><motor name="m" joint="left"/></actuator>'
    )
    assert read(tmp_path, gripper(rest)).joint_names == ("wrist", "left")


def test_held_fingers_take_their_tendon_actuator_sensors_and_keyframes_along(tmp_path):
    rest = f"""{TENDON}
        <equality><joint joint1="left" joint2="right"/></equality>
        <actuator><motor name="turn" joint="wrist"/><general name="grip" tendon="split"/></actuator>
        <sensor><jointpos joint="left"/><tendonpos tendon="split"/><actuatorfrc actuator="grip"/></sensor>
        <keyframe><key name="home" qpos="0 0 0"/></keyframe>"""
    with pytest.raises(TreeError, match=r'the tendon "split" acts on joints.*held: \["right"\]'):
        read(tmp_path, gripper(rest))
    system = read(tmp_path, gripper(rest), '["left", "right"]')
    assert system.joint_names == ("wrist",)
    assert [c.name for c in system.commands] == ["turn"]
    robot, changes = write_robot(system, tmp_path)
    assert mujoco.MjModel.from_xml_path(str(robot)).njnt == 1
    assert "held" in changes.read_text()


def test_a_base_on_a_stand_is_held(tmp_path):
    base = f"""<mujoco><worldbody><body name="trunk" pos="0 0 .4"><freejoint/>{INERTIAL.format(mass=5)}
        <body name="leg"><joint name="hip" axis="0 1 0"/>{INERTIAL.format(mass=1)}</body></body></worldbody></mujoco>"""
    with pytest.raises(TreeError, match=r'has a free joint, "trunk".*held: \["trunk"\]'):
        read(tmp_path, base)
    fixed = base.replace("<freejoint/>", "")
    (tmp_path / "other").mkdir()
    state = ([0.3], [0.5])
    assert accelerations(read(tmp_path, base, "trunk"), *state) == pytest.approx(
        accelerations(read(tmp_path / "other", fixed), *state), rel=1e-12
    )


@pytest.mark.parametrize(
    ("held", "words"),
    [
        ("[wrst]", 'there is no joint "wrst"; did you mean wrist'),
        ("3", "expected a list of joints"),
        ("{wrist: far}", "expected a number"),
    ],
)
def test_held_joints_that_cannot_be_understood_are_refused(tmp_path, held, words):
    with pytest.raises(TreeError, match=words):
        read(tmp_path, gripper(), held)


def test_a_tendon_of_which_only_one_joint_is_held_is_refused(tmp_path):
    rest = f"""{TENDON}
        <actuator><general name="grip" tendon="split"/></actuator>"""
    with pytest.raises(TreeError, match="and on right; hold these too: write held"):
        read(tmp_path, gripper(rest), "[left]")


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(-6.0, 2.0))
def test_nearest_inertia_is_one_that_matter_has_and_leaves_such_ones_alone(seed, size):
    rng = np.random.default_rng(seed)
    any_matrix = rng.normal(size=(3, 3))
    given_one = 10.0**size * (any_matrix + any_matrix.T + 2.0 * rng.uniform() * np.eye(3))
    found = nearest_inertia(given_one)
    second = 0.5 * np.trace(given_one) * np.eye(3) - given_one
    if np.linalg.eigvalsh(second)[-1] <= 0.0:
        return  # nothing in it says how large the body is
    moments = np.linalg.eigvalsh(found)
    assert moments[0] > 0.0
    assert moments[2] <= (moments[0] + moments[1]) * (1.0 + 1e-12)
    assert nearest_inertia(found) == pytest.approx(found, rel=1e-9)
    points = rng.normal(size=(5, 3))
    matter = sum((p @ p * np.eye(3) - np.outer(p, p) for p in points), np.zeros((3, 3)))
    assert nearest_inertia(matter) is matter
    # No other body of matter that was tried is nearer by its second moments.
    other = 0.5 * np.trace(matter) * np.eye(3) - matter
    near = 0.5 * np.trace(found) * np.eye(3) - found
    flat = 1e-4 * np.linalg.eigvalsh(second)[-1]
    assert np.linalg.norm(near - second) <= np.linalg.norm(other - second) + 3.0 * flat


URDF = """<robot name="robot"><link name="base">{inertial}</link><link name="between"/>
    <link name="arm"><inertial><mass value="1"/><origin xyz="0 0 -.1"/>
    <inertia ixx="{ixx}" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial></link>
    <joint name="pan" type="continuous"><parent link="base"/><child link="between"/><axis xyz="1 0 0"/></joint>
    <joint name="tilt" type="continuous"><parent link="between"/><child link="arm"/><axis xyz="0 1 0"/></joint>
    </robot>"""
DOUBTFUL = """<inertial><mass value="1e-6"/>
    <inertia ixx="1e-6" ixy="1e-6" ixz="1e-6" iyy="1e-6" iyz="1e-6" izz="1e-6"/></inertial>"""


def test_a_urdf_with_a_link_between_two_axes_and_a_doubtful_base_moves_as_one_body_with_both_axes(tmp_path):
    system = read(tmp_path, URDF.format(inertial=DOUBTFUL, ixx=".012"), name="robot.urdf")
    one_body = f"""<mujoco><worldbody><body name="arm"><joint name="pan" axis="1 0 0"/><joint name="tilt" axis="0 1 0"/>
        {INERTIAL.format(mass=1).replace(".01 .02 .015", ".012 .01 .01")}</body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(one_body)
    other = TreeSystem(compile_tree(model, "other"))
    state = ([0.4, -0.7], [0.5, 1.0])
    assert accelerations(system, *state) == pytest.approx(accelerations(other, *state), rel=1e-6)
    assert not any("between" in p.name for p in system.parameters)


def test_an_inertia_that_no_matter_has_is_mended_and_named(tmp_path):
    system = read(tmp_path, URDF.format(inertial="", ixx=".03"), name="robot.urdf")
    assert "no body of matter has the inertia given for arm" in " ".join(system.notes)
    moments = sorted(system.tree.bodies[-1].moments)
    assert moments == pytest.approx([0.015, 0.015, 0.03], rel=1e-3)


def test_changes_list_what_was_read_otherwise_than_it_stands_in_the_file(tmp_path):
    system = read(tmp_path, gripper(), "[left]")
    _, changes = write_robot(system, tmp_path)
    assert "- held, as the settings say: left\n" in changes.read_text()
