"""Dry friction that creeps: against its equation of motion, against friction that holds, and against MuJoCo."""

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from deepkoco.fit.simulate.equations import equations_of
from deepkoco.fit.simulate.torch_steps import StepsInput, in_torch
from deepkoco.systems import ExtendedSystem, load_model, load_system, save_model
from deepkoco.systems.creep import Creep, slide_and_creep
from deepkoco.systems.dry_friction import rubbed, slide_and_rest
from deepkoco.systems.model_yaml import ModelFileError
from deepkoco.systems.rollout import RolloutInput
from deepkoco.systems.stick_slip import Joints, StickSlip

HEAD = """
<mujoco model="head"><compiler angle="radian"/><option timestep="5e-5"/>
<worldbody><body><joint name="pan" axis="0 0 1" damping="0.1" frictionloss="0.12" armature="0.01"/>
  <geom type="box" size="0.05 0.04 0.06" mass="0.6"/>
  <body pos="0 0 0.1"><joint name="tilt" axis="0 1 0" damping="0.08" frictionloss="0.1" armature="0.008"/>
    <geom type="box" size="0.06 0.03 0.03" pos="0.04 0 0.02" mass="0.5"/></body></body></worldbody>
<actuator><motor name="m_pan" joint="pan"/><motor name="m_tilt" joint="tilt"/></actuator></mujoco>
"""
QUICK = settings(deadline=None, max_examples=25)
speeds, pulls = st.floats(-2.0, 2.0), st.floats(-30.0, 30.0)


def number(x):
    return torch.tensor(float(x), dtype=torch.float64)


def stepped(speed, free, level, own, creep, h):
    return tuple(float(x) for x in slide_and_creep(*map(number, (speed, free, level, own)), creep, h))


@QUICK
@given(
    speeds, pulls, st.floats(0.01, 1.0), st.floats(5.0, 100.0), st.floats(0.02, 2.0), st.floats(20.0, 200.0)
)
def test_a_step_is_the_motion_under_the_soft_constraint(speed, free, level, own, inertia, rate):
    def acceleration(v):
        # f = -clip(D (v' + b v), -F, F) with v' = free + W f: solved for f without the closed form
        left = lambda f: f + np.clip(inertia * (free + own * f + rate * v), -level, level)  # noqa: E731
        return free + own * brentq(left, -2.0 * level, 2.0 * level, xtol=1e-14)

    h = 0.02
    exact = solve_ivp(lambda _, y: [y[1], acceleration(y[1])], (0, h), [0.0, speed], rtol=1e-9, atol=1e-11)
    after, way = stepped(speed, free, level, own, Creep(number(inertia), rate), h)
    assert after == pytest.approx(exact.y[1, -1], abs=2e-6)
    assert way == pytest.approx(exact.y[0, -1], abs=2e-8)


@QUICK
@given(speeds, pulls, st.floats(0.01, 1.0))
def test_a_stiff_constraint_holds_as_friction_at_rest_does(speed, free, level):
    own, h = 10.0, 0.02
    rigid = slide_and_rest(number(speed), number(free), number(own * level), number(own * level), h)
    after, way = stepped(speed, free, level, own, Creep(number(1e6), 1e6), h)
    assert after == pytest.approx(float(rigid[0]), abs=1e-4)
    assert way == pytest.approx(float(rigid[1]), abs=1e-5)


def test_a_joint_below_its_level_creeps_at_load_over_d_times_b():
    load, own, creep = 0.1, 80.0, Creep(number(0.11), 105.0)
    after, way = stepped(load / (0.11 * 105.0), own * load, 0.12, own, creep, 0.05)
    assert after == pytest.approx(load / (0.11 * 105.0))
    assert way == pytest.approx(0.05 * load / (0.11 * 105.0))


@QUICK
@given(st.integers(0, 10_000), st.integers(1, 4))
def test_the_compiled_loop_agrees_with_torch(seed, joints):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((joints, joints))
    inverse = root @ root.T + 3.0 * np.eye(joints)
    before, free, levels = (
        rng.standard_normal(joints),
        5.0 * rng.standard_normal(joints),
        rng.uniform(0.1, 1.0, joints),
    )
    creeps = tuple(
        Creep(number(d), b)
        for d, b in zip(rng.uniform(0.5, 3.0, joints), rng.uniform(20, 150, joints), strict=True)
    )

    def tensors(values, grad=False):
        return tuple(number(v).requires_grad_(grad) for v in values)

    level, zero, h = tensors(levels), tensors(np.zeros(joints)), 0.01
    rows = tuple(tensors(row) for row in inverse)
    found, wanted = (
        rubbed(tensors(before, grad), tensors(before + h * free), zero, level, level, rows, h, creeps)
        for grad in (False, True)
    )
    for a, b in zip((*found.speed, *found.moved), (*wanted.speed, *wanted.moved), strict=True):
        assert float(a) == pytest.approx(float(b.detach()), abs=1e-6)
    # Nothing in it depends on the order of the joints' own equations: the loads balance each joint's constraint.
    assert all(abs(float(f)) <= F + 1e-9 for f, F in zip(found.load, levels, strict=True))


@QUICK
@given(st.integers(0, 10_000), st.integers(1, 3))
def test_friction_is_found_before_an_armature_of_the_step(seed, joints):
    # Level without bound: f = -D (a + b v) with M a = u + f, and then (M + A) a' = u + f. All joints creep.
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((joints, joints))
    mass, load, speed = (
        root @ root.T + np.eye(joints),
        rng.standard_normal(joints),
        0.1 * rng.standard_normal(joints),
    )
    armature, soft, rate, h = rng.uniform(0.05, 0.5, joints), rng.uniform(0.5, 3.0, joints), 50.0, 1e-6
    bare, whole = np.linalg.inv(mass), np.linalg.inv(mass + np.diag(armature))
    friction = np.linalg.solve(np.eye(joints) + soft[:, None] * bare, -soft * (bare @ load + rate * speed))
    wanted = whole @ (load + friction)

    def tensors(values):
        return tuple(number(v) for v in values)

    zero, level = tensors(np.zeros(joints)), tensors(np.full(joints, 100.0))
    found = rubbed(
        tensors(speed), tensors(speed + h * (whole @ load)), zero, level, level, tuple(map(tensors, whole)), h,
        tuple(Creep(number(d), rate) for d in soft), tensors(armature),
    )  # fmt: skip
    got = [(float(v) - w) / h for v, w in zip(found.speed, speed, strict=True)]
    assert got == pytest.approx(wanted, rel=1e-3, abs=1e-3)


@pytest.fixture(scope="module")
def head(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "head.xml"
    path.write_text(HEAD)
    return load_system(path)


def in_mujoco(efforts, h):
    model = mujoco.MjModel.from_xml_string(HEAD)
    data, path = mujoco.MjData(model), []
    for effort in efforts:
        for _ in range(round(h / model.opt.timestep)):
            data.ctrl[:] = effort
            mujoco.mj_step(model, data)
        path.append(data.qpos.copy())
    return np.array(path)


def in_ours(system, efforts, h, compiled):
    start = (torch.zeros(1, 1, dtype=torch.float64),) * 4
    begin = [torch.from_numpy(efforts[:, k].copy()).view(-1, 1, 1) for k in range(2)]
    slope = [torch.zeros_like(x) for x in begin]
    p = system.default_parameters()
    if compiled:
        given = RolloutInput(h, start, start[0], begin, slope, None, system.dry_friction_levels(p))
        nodes = system.rollout(p).run(given)
    else:
        nodes = in_torch(equations_of(system, p, None), StepsInput(h, start, start[0], begin, slope, None))
    return np.stack([nodes.value[k][1:, 0, 0].numpy() for k in range(2)], 1)


def test_a_tree_creeps_as_in_mujoco(head):
    rng, h = np.random.default_rng(1), 0.005
    efforts = np.repeat(rng.uniform(-0.2, 0.2, (10, 2)), 20, axis=0)  # mostly near the level of the friction
    truth, creeping = in_mujoco(efforts, h), head.with_engine()
    error = np.abs(in_ours(creeping, efforts, h, compiled=True) - truth).max()
    assert error < 1e-3 * np.abs(truth).max()
    assert np.abs(in_ours(head, efforts, h, compiled=True) - truth).max() > 20.0 * error


SLIDE = '<joint name="{0}" type="slide" axis="{1}" frictionloss="4" armature="0.15"/>'
TURN = '<joint name="{0}" axis="0 0 1" frictionloss="4" armature="0.15"/>'
BOX = '<geom type="box" size="0.03 0.02 0.05" mass="0.42"/>'


@pytest.mark.parametrize(
    "joints",
    [
        [SLIDE.format("a", "1 0 0")],
        [SLIDE.format("a", "1 0 0") + BOX + "<body>" + SLIDE.format("b", "0 1 0")],
        [SLIDE.format("a", "1 0 0") + BOX + "<body>" + TURN.format("b")],
        [TURN.format("a")],
        [SLIDE.format("a", "1 0 0"), TURN.format("b")],
    ],
    ids=["slide", "slide on slide", "hinge on slide", "hinge", "slide beside hinge"],
)
def test_joints_with_armature_creep_as_fast_as_in_mujoco(joints, tmp_path):
    bodies = "".join(f"<body>{own}{BOX}{'</body>' * (1 + own.count('<body>'))}" for own in joints)
    names = [name for name in "ab" if f'name="{name}"' in bodies]
    motors = "".join(f'<motor name="m_{name}" joint="{name}"/>' for name in names)
    text = (
        '<mujoco><option gravity="0 0 0" timestep="5e-4"/><default><geom contype="0" conaffinity="0"/></default>'
        f"<worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
    path = tmp_path / "robot.xml"
    path.write_text(text)
    system = load_system(path).with_engine()
    for k in range(len(names)):
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        data.ctrl[k] = 2.0
        mujoco.mj_step(model, data, 1000)
        creep = system.dry_friction_levels(system.default_parameters()).creeps[k]
        assert 2.0 / float(creep.inertia * creep.rate) == pytest.approx(data.qvel[k], rel=1e-5)


def test_steps_in_torch_creep_as_the_compiled_ones(head):
    efforts = np.repeat(np.random.default_rng(2).uniform(-0.2, 0.2, (8, 2)), 10, axis=0)
    extended = ExtendedSystem(
        head.with_engine(), ("coulomb(pan)", "stribeck(tilt)"), {"coulomb(pan).torque": 0.05}
    )
    for system in (head.with_engine(), extended):
        ours = [in_ours(system, efforts, 0.01, compiled) for compiled in (True, False)]
        np.testing.assert_allclose(ours[0], ours[1], atol=2e-6)  # speeds late by a stage, or at once


def test_an_environment_creeps_as_a_simulation_along_a_log(head):
    system, h = head.with_engine(), 0.005
    efforts = np.repeat(np.random.default_rng(4).uniform(-0.2, 0.2, (6, 2)), 10, axis=0)
    along = in_ours(system, efforts, h, compiled=True)
    law, zero = StickSlip(system, system.default_parameters()), torch.zeros(1, dtype=torch.float64)
    joints, path = Joints((zero, zero), (zero, zero), (zero, zero), ()), []
    for effort in efforts:
        joints = law.tick(joints, tuple(torch.from_numpy(effort[:, None])), h)
        path.append([float(q) for q in joints.angles])
    np.testing.assert_allclose(np.array(path), along, atol=2e-6)


def test_a_model_file_keeps_the_kind_of_friction(head, tmp_path):
    extended = ExtendedSystem(head, ("coulomb(pan)",), {"coulomb(pan).torque": 0.05})
    as_file, fine = extended.with_engine(), extended.with_engine(step=1e-4)
    rigid = extended.with_engine("semi-implicit", 0.004)
    named = ((extended, "holds"), (as_file, "creeps"), (fine, "in_fine_steps"), (rigid, "rigid"))
    for system, name in ((own, f"{stem}.yaml") for own, stem in named):
        save_model(tmp_path / name, system)
        read = load_model(tmp_path / name)
        assert (read.engine, read.engine_step) == (system.engine, system.engine_step)
        assert read.parameter("coulomb(pan).torque").value == 0.05


@pytest.mark.parametrize("step", ["two", "true", "-0.001", ".inf"])
def test_a_model_file_with_a_step_that_is_no_time_is_refused(head, tmp_path, step):
    save_model(tmp_path / "model.yaml", ExtendedSystem(head, (), {}).with_engine())
    text = (tmp_path / "model.yaml").read_text()
    assert "engine_step: 5.0e-05" in text
    (tmp_path / "model.yaml").write_text(text.replace("engine_step: 5.0e-05", f"engine_step: {step}"))
    with pytest.raises(ModelFileError, match="engine_step"):
        load_model(tmp_path / "model.yaml")


def test_a_model_file_of_a_machine_has_no_steps(head, tmp_path):
    save_model(tmp_path / "model.yaml", ExtendedSystem(head, (), {}).with_engine())
    text = (tmp_path / "model.yaml").read_text()
    (tmp_path / "model.yaml").write_text(text.replace("engine: MuJoCo\n", ""))
    with pytest.raises(ModelFileError, match="a machine has no steps"):
        load_model(tmp_path / "model.yaml")
