"""Reading MJCF and URDF: what is compiled, what is refused, and in which words."""

import os

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.systems.effects import effects_of
from deepkoco.systems.motion import Motion
from deepkoco.systems.trees import TreeError, TreeSystem
from deepkoco.systems.trees.model_file import read_model

LINK = '<body name="{name}"><joint name="{joint}" axis="0 1 0"/>{inside}</body>'
CAPSULE = '<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3"/>'
INERTIAL = '<inertial pos="0 0 -.1" mass="1" diaginertia=".01 .01 .01"/>'
MESH = '<asset><mesh name="shell" file="shell.stl"/></asset>'
SHELL = '<geom type="mesh" mesh="shell"/>'

MIMIC_OF_A_PLANE = """<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/>
<inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial></link>
<joint name="table" type="planar"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<mimic joint="other"/></joint>
</robot>"""


def link(inside=CAPSULE, name="arm", joint="hinge"):
    return LINK.format(name=name, joint=joint, inside=inside)


def mjcf(bodies, rest=""):
    return f"<mujoco><worldbody>{bodies}</worldbody>{rest}</mujoco>"


def urdf(inertial=True, visual=False, kind="revolute"):
    mass = (
        '<inertial><mass value="1"/><origin xyz="0 0 -.1"/>'
        '<inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial>'
    )
    shape = '<{0}><geometry><mesh filename="package://robot/meshes/arm.stl"/></geometry></{0}>'
    shapes = shape.format("visual") + shape.format("collision")
    return (
        f'<robot name="robot"><link name="base"/><link name="arm">{mass * inertial}{shapes * visual}</link>'
        f'<joint name="hinge" type="{kind}"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="5" velocity="3"/></joint></robot>'
    )


def read(tmp_path, text, name="robot.xml"):
    path = tmp_path / name
    path.write_text(text)
    return TreeSystem.from_file(path)


REFUSED = {
    "unknown element": (mjcf('<body name="a"><hinge name="x"/></body>'), 'no element "hinge"'),
    "unknown attribute": (
        mjcf('<body><joint nmae="x"/></body>'),
        'the element "joint" has no attribute "nmae"',
    ),
    "no XML": ("arm: 3", "is no valid XML"),
    "no inertia": (mjcf(link("")), 'nothing behind the joint "hinge" has a mass'),
    "name twice": (mjcf(link() + link(name="other")), 'called "hinge"'),
    "free joint": (mjcf(f'<body name="box"><freejoint/>{CAPSULE}</body>'), 'the body "box" has a free joint'),
    "ball joint": (mjcf(f'<body name="box"><joint type="ball"/>{CAPSULE}</body>'), "ball joint"),
    "nothing moves": (mjcf(f"<body>{CAPSULE}</body>"), "no joints"),
    "equality": (
        mjcf(
            link(CAPSULE + link(name="b", joint="y")),
            '<equality><joint name="linkage" joint1="hinge" joint2="y"/></equality>',
        ),
        'the equality constraint "linkage" is active',
    ),
    "weld": (
        mjcf(
            link() + link(name="b", joint="y"),
            '<equality><weld name="glue" body1="arm" body2="b"/></equality>',
        ),
        'the equality constraint "glue" is active',
    ),
    "gravity held up by the actuator": (
        mjcf('<body><joint name="x" axis="0 1 0" actuatorgravcomp="true"/><geom size=".1"/></body>'),
        'the joint "x" has actuatorgravcomp',
    ),
    "tendon": (
        mjcf(
            link(),
            '<tendon><fixed name="rope"><joint joint="hinge" coef="1"/></fixed></tendon>'
            '<actuator><motor name="m" tendon="rope"/></actuator>',
        ),
        'the tendon "rope" acts',
    ),
    "muscle": (mjcf(link(), '<actuator><muscle name="m" joint="hinge"/></actuator>'), '"m" is a muscle'),
    "integrator": (
        mjcf(link(), '<actuator><intvelocity name="m" joint="hinge" kp="1" actrange="-1 1"/></actuator>'),
        '"m" has dynamics other than',
    ),
    "force at a site": (
        mjcf(link(CAPSULE + '<site name="s"/>'), '<actuator><motor name="m" site="s"/></actuator>'),
        '"m" does not drive a joint',
    ),
    "missing mesh that decides the inertia": (
        mjcf(link(SHELL), MESH),
        'the mesh file "shell.stl" is missing',
    ),
    "missing include": ('<mujoco><include file="nope.xml"/></mujoco>', '"nope.xml"'),
    "channel twice": (
        mjcf(link(), '<actuator><motor name="q_hinge" joint="hinge"/></actuator>'),
        'two channels are called "q_hinge"',
    ),
    "gear of 0": (
        mjcf(link(), '<actuator><motor name="m" joint="hinge" gear="0"/></actuator>'),
        "the gear 0",
    ),
    "two slides along one axis": (
        mjcf(
            '<body><joint name="x1" type="slide" axis="1 0 0"/><joint name="x2" type="slide" axis="1 0 0"/>'
            '<geom size=".1"/></body>'
        ),
        "the joints x1, x2 move the same bodies",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_model_that_is_no_tree_is_refused_in_one_sentence_with_its_file_and_element(case, tmp_path):
    text, named = REFUSED[case]
    with pytest.raises(TreeError) as error:
        read(tmp_path, text)
    message = str(error.value)
    assert message.startswith(str(tmp_path / "robot.xml"))
    assert named in message
    assert "\n" not in message


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(TreeError, match="there is no such file"):
        TreeSystem.from_file(tmp_path / "robot.xml")


def test_missing_meshes_are_left_out_where_bodies_have_their_inertia(tmp_path):
    system = read(tmp_path, mjcf(link(INERTIAL + SHELL), MESH))
    assert system.default_parameters()["mass(arm)"] == 1.0
    assert any("shell.stl" in note for note in system.notes)


def test_urdf_is_read_without_its_meshes_and_its_joints_take_loads(tmp_path):
    system = read(tmp_path, urdf(visual=True), "robot.urdf")
    (command,) = system.commands
    assert (command.name, command.unit, command.low, command.high) == ("hinge", "N m", -5.0, 5.0)
    assert command.default == 0.0
    assert system.joint_names == ("hinge",)
    with pytest.raises(TreeError, match=r"arm\.stl"):
        read(tmp_path, urdf(inertial=False, visual=True), "bare.urdf")


def test_what_has_no_name_gets_one_and_every_effect_can_be_placed(tmp_path):
    inner = f'<body pos="0 0 -.3"><joint axis="0 1 0"/><joint type="slide" axis="1 0 0"/>{CAPSULE}</body>'
    rest = '<actuator><motor joint="top.1" ctrlrange="-1 0"/></actuator>'
    text = mjcf(f'<body><joint name="top.1" axis="0 1 0"/>{CAPSULE}{inner}</body>', rest)
    system = read(tmp_path, text.replace("<worldbody>", "<worldbody>", 1))
    assert len(set(system.joint_names)) == 3
    assert "top_1" in system.joint_names
    assert any('"top.1"' in note for note in system.notes)
    assert len(effects_of(system)) > 20


def test_a_warning_of_mujoco_is_a_note_and_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.urdf").write_text(MIMIC_OF_A_PLANE)
    _, notes = read_model(tmp_path / "robot.urdf")
    assert [n for n in notes if "<mimic> on joint 'table' ignored" in n and n.startswith("MuJoCo says: ")]
    assert [p.name for p in tmp_path.iterdir()] == ["robot.urdf"]


def test_notes_say_that_contacts_and_limits_are_not_simulated(tmp_path):
    ground = '<geom type="plane" size="1 1 .1"/>'
    system = read(tmp_path, mjcf(ground + link(CAPSULE).replace("axis", 'range="-1 1" limited="true" axis')))
    assert any("contacts are not simulated" in note for note in system.notes)
    assert any("limits of joints are not simulated: hinge" in note for note in system.notes)
    silent = read(tmp_path, mjcf(link(CAPSULE.replace("<geom", '<geom contype="0" conaffinity="0"'))))
    assert [note.split(":")[0] for note in silent.notes] == ["the file has no drives"]


def test_a_drive_that_a_file_cannot_describe_has_a_rotor_and_damping_with_wide_priors(tmp_path):
    told = {p.name: p for p in read(tmp_path, urdf(), "robot.urdf").parameters}
    moved = 1.0 * 0.1**2 + 0.01  # of a body of 1 kg, 0.1 m from its axis
    for name in ("armature(hinge)", "damping(hinge)"):
        assert told[name].value == told[name].low == 0.0
        assert told[name].prior_sd >= moved
        assert not told[name].guessed
    arm = mjcf(link(), '<actuator><motor joint="hinge"/></actuator>')
    stated = {p.name: p for p in read(tmp_path, arm).parameters}
    assert 0.0 < stated["armature(hinge)"].prior_sd < 0.1 * moved
    assert "damping(hinge)" not in stated


def test_two_actuators_of_one_joint_add_up_and_the_second_comes_last(tmp_path):
    rest = (
        '<actuator><velocity name="brake" joint="hinge" kv="2"/><position name="goal" joint="hinge" kp="9"/>'
        '<motor name="push" joint="elbow"/></actuator>'
    )
    text = mjcf(link(CAPSULE + link(joint="elbow", name="fore")), rest)
    system = read(tmp_path, text)
    assert [c.name for c in system.commands] == ["brake", "push", "goal"]
    assert system.command_joints == (0, 1)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    q, v, u = np.array([0.3, -0.4]), np.array([0.5, 0.7]), np.array([0.2, 0.4, -0.3])
    data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u[[0, 2, 1]]
    mujoco.mj_forward(model, data)
    found = system.derivative(torch.from_numpy(np.r_[q, v]), torch.from_numpy(u), system.default_parameters())
    np.testing.assert_allclose(found[2:].numpy(), data.qacc, rtol=1e-9)


def test_a_position_servo_with_a_constant_force_keeps_the_unit_of_its_joint(tmp_path):
    law = 'biastype="affine" gainprm="4000" biasprm="12 -4000 -150"'
    text = mjcf(
        f'<body name="quill"><joint name="z" type="slide"/>{INERTIAL}</body>',
        f'<actuator><general name="lift" joint="z" {law}/></actuator>',
    )
    system = read(tmp_path, text)
    (command,) = system.commands
    assert command.unit == "m"
    values = {p.name: p.value for p in system.parameters}
    assert (values["kp(lift)"], values["bias(lift)"], values["kv(lift)"]) == (4000.0, 12.0, 150.0)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = 0.03, 0.2, 0.05
    mujoco.mj_forward(model, data)
    place, speed, effort = (torch.tensor(x, dtype=torch.float64) for x in (0.03, 0.2, 0.05))
    parameters = system.default_parameters()
    for own in (parameters, {n: v.requires_grad_() for n, v in parameters.items()}):
        (found,) = system.accelerations(own)(Motion((place,), (speed,), (effort,)))
        np.testing.assert_allclose(found.item(), data.qacc[0], rtol=1e-9)


@pytest.mark.skipif("DEEPKOCO_REAL_LOGS" not in os.environ, reason="needs the real logs")
@pytest.mark.parametrize("ending", ["xml", "urdf"])
def test_the_model_of_a_real_arm_is_read_without_its_meshes(ending):
    system = TreeSystem.from_file(f"{os.environ['DEEPKOCO_REAL_LOGS']}/so101/so101_without_meshes.{ending}")
    assert system.joints == 6
    assert len(system.commands) == 6
