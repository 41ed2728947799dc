"""The compiled loop over all steps of a simulation, against the steps of the simulator in torch."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco.fit.data.noise import Noise
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.shooting import ShootingProblem
from deepkoco.fit.simulate import simulator
from deepkoco.fit.simulate.equations import friction_of
from deepkoco.fit.simulate.simulator import integrate
from deepkoco.systems import ExtendedSystem
from deepkoco.systems.effects import effects_of
from deepkoco.systems.effects.learned import is_weight
from deepkoco.systems.rollout import RolloutInput
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.rollout import KINDS, TreeRollout

ARM = """
<mujoco model="arm">
  <worldbody>
    <body name="rail" pos="0 0 1">
      <joint name="cart" type="slide" axis="1 0 0" damping="2" frictionloss="0.8"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.02 0.02 0.02"/>
      <body name="upper" pos="0 0 0">
        <joint name="shoulder" axis="0 1 0" damping="0.5" armature="0.01" frictionloss="0.3" stiffness="1"/>
        <inertial pos="0 0 -0.15" mass="1" diaginertia="0.01 0.01 0.001"/>
        <body name="fore" pos="0.1 0 -0.3">
          <joint name="elbow" axis="0 1 1" damping="0.1" armature="0.005"/>
          <inertial pos="0 0 -0.12" mass="0.5" diaginertia="0.004 0.004 0.0005"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m_cart" joint="cart" ctrlrange="-10 10"/>
    <position name="m_shoulder" joint="shoulder" kp="40" kv="1" forcerange="-4 4" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""
SECONDS, STEP, LANES = 0.4, 0.004, 12


@pytest.fixture
def arm(tmp_path) -> TreeSystem:
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return TreeSystem.from_file(path)


def steps_in_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no compiled loop simulate."""
    monkeypatch.setattr(TreeSystem, "rollout", lambda *_: None)
    monkeypatch.setattr(simulator, "along_windows", lambda *_: None)


def three_windows(arm: TreeSystem, rng: np.random.Generator) -> Windows:
    stamps = np.arange(0.0, 3.0, 0.05)
    sizes = [4.0, 0.8, 2.0][: len(arm.commands)]
    commands = CommandSeries(stamps, rng.uniform(-1.0, 1.0, (len(stamps), len(sizes))) * sizes)
    none = torch.zeros(3, len(arm.measurements), 0, dtype=torch.float64)
    return Windows(
        (commands,),
        np.zeros(3, dtype=int),
        np.array([0.5, 1.0, 2.0]),
        STEP,
        round(SECONDS / STEP),
        none,
        none,
        none.bool(),
        (Noise(1e-3, 0.0),) * len(arm.measurements),
        torch.zeros(3, 6, dtype=torch.float64),
        np.zeros(3, dtype=bool),
    )


@pytest.mark.parametrize("kind", [*KINDS, "constant_load", "coulomb", "gain", "force"])
def test_compiled_rollout_takes_the_steps_of_the_simulator(arm, kind, monkeypatch):
    rng = np.random.default_rng(3)
    placed = effects_of(arm)
    system = ExtendedSystem(arm, tuple(name for name, own in placed.items() if own.effect.name == kind))
    values = {}
    for p in system.parameters:
        drawn = p.value + p.prior_sd * rng.uniform(-0.5, 1.0, LANES)
        drawn[0] = p.value  # the first lane has no effect
        values[p.name] = torch.from_numpy(np.clip(drawn, p.low, p.high))
    windows = three_windows(arm, rng)
    start = torch.from_numpy(rng.normal(size=(LANES, 3, 6)) * [0.1, 0.5, 0.5, 0.3, 1.0, 1.0])
    start[:, 0, 3:] = 0.0  # all joints rest
    push = torch.zeros(3, LANES, 3, windows.steps, dtype=torch.float64)
    push[1, 4, :, 20:40] = 2.0
    compiled = integrate(system, windows, values, start, push)
    assert system.rollout(values) is not None
    steps_in_torch(monkeypatch)
    expected = integrate(system, windows, values, start, push)
    for part, other in zip(compiled, expected, strict=True):
        for own, wanted in zip(part, other, strict=True):
            torch.testing.assert_close(own, wanted, rtol=1e-8, atol=1e-9)
    sticks = (expected.value[3] == 0.0).double().mean()
    assert 0.0 < sticks < 1.0


BESIDE = """
<mujoco model="beside">
  <worldbody>
    <body name="rail" pos="0 0 1" euler="20 10 0">
      <joint name="cart" type="slide" axis="1 0 1" damping="2" frictionloss="0.8"/>
      <inertial pos="0.1 0 0.05" mass="2" diaginertia="0.02 0.02 0.02"/>
    </body>
    <body name="arm" pos="0 1 0" euler="5 30 0">
      <joint name="swing" axis="0.2 1 0" damping="0.05" armature="0.01" frictionloss="0.1"/>
      <inertial pos="0.05 0.02 -0.2" mass="0.7" diaginertia="0.01 0.02 0.001"/>
    </body>
    <body name="wheel" pos="0 2 0">
      <joint name="wheel" axis="0 0 1" damping="0.02"/>
      <inertial pos="0 0 0" mass="0.7" diaginertia="0.01 0.02 0.01"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="m_cart" joint="cart" ctrlrange="-10 10"/>
    <motor name="m_swing" joint="swing" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""


def test_joints_that_the_base_carries_alone_take_the_steps_of_the_simulator(tmp_path, monkeypatch):
    path = tmp_path / "beside.xml"
    path.write_text(BESIDE)
    three = TreeSystem.from_file(path)
    rng = np.random.default_rng(8)
    values = {
        p.name: torch.from_numpy(p.value + 0.3 * p.prior_sd * rng.uniform(-1.0, 1.0, LANES))
        for p in three.parameters
    }
    windows = three_windows(three, rng)
    start = torch.from_numpy(rng.normal(size=(LANES, 3, 6)) * [0.1, 2.0, 0.5, 0.3, 1.0, 1.0])
    compiled = integrate(three, windows, values, start)
    assert three.rollout(values) is not None
    steps_in_torch(monkeypatch)
    expected = integrate(three, windows, values, start)
    for part, other in zip(compiled, expected, strict=True):
        for own, wanted in zip(part, other, strict=True):
            torch.testing.assert_close(own, wanted, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(
    "joint", ["cart", "shoulder", "elbow"]
)  # one slides, one has a servo, one has no actuator
def test_compiled_rollout_has_every_term_of_a_learned_load(arm, joint, monkeypatch):
    rng = np.random.default_rng(6)
    system = ExtendedSystem(arm, (f"learned({joint})",))
    weights = [p for p in system.parameters if is_weight(p.name)]
    lanes = len(weights) + 1  # each term alone, and all together
    values = {p.name: torch.full((lanes,), p.value, dtype=torch.float64) for p in system.parameters}
    for k, p in enumerate(weights):
        values[p.name][k] = values[p.name][-1] = 0.4 * p.prior_sd * rng.uniform(-1.0, 1.0)
    for name, scale in (("speed", 0.4), ("effort", 1.5), ("angle", 0.1)):
        if f"learned({joint}).{name}_scale" in values:
            values[f"learned({joint}).{name}_scale"].fill_(scale)
    values[f"learned({joint}).angle_middle"].fill_(0.1)
    windows = three_windows(arm, rng)
    start = torch.from_numpy(rng.normal(size=(3, 6)) * [0.1, 0.5, 0.5, 0.5, 1.0, 1.0])
    start[:, arm.joint_names.index(joint)] = torch.tensor([-0.4, 0.1, 0.6])
    start = start.repeat(lanes, 1, 1)
    assert system.rollout(values) is not None
    compiled = integrate(system, windows, values, start)
    steps_in_torch(monkeypatch)
    expected = integrate(system, windows, values, start)
    none = integrate(arm, windows, {p.name: values[p.name] for p in arm.parameters}, start)
    j = arm.joint_names.index(joint)
    moved = (expected.value[3 + j] - none.value[3 + j]).abs().amax((0, 1))
    assert (moved > 1e-4).all()
    for part, other in zip(compiled, expected, strict=True):
        for own, wanted in zip(part, other, strict=True):
            torch.testing.assert_close(own, wanted, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("effect", ["learned", "load_friction", "crosstalk", "torque_speed_curve"])
def test_loads_that_follow_a_joint_with_two_actuators_see_their_sum(tmp_path, effect, monkeypatch):
    rng = np.random.default_rng(7)
    path = tmp_path / "arm.xml"
    path.write_text(ARM.replace("</actuator>", '<motor name="m_more" joint="shoulder"/></actuator>'))
    arm = TreeSystem.from_file(path)
    assert len(arm.commands) == 3
    placed = effects_of(arm)
    system = ExtendedSystem(arm, tuple(name for name, own in placed.items() if own.effect.name == effect))
    values = {p.name: torch.full((2,), p.value, dtype=torch.float64) for p in system.parameters}
    for p in system.parameters:
        follows = p.name.rpartition(".")[2] in ("u", "u_abs_u", "coefficient", "share", "ratio", "droop")
        if p.name not in {q.name for q in arm.parameters} and (follows or effect != "learned"):
            values[p.name][1] += min(p.prior_sd, 0.5 * (p.high - p.value))
    windows = three_windows(arm, rng)
    start = torch.from_numpy(rng.normal(size=(3, 6)) * 0.3).repeat(2, 1, 1)
    compiled = integrate(system, windows, values, start)
    steps_in_torch(monkeypatch)
    expected = integrate(system, windows, values, start)
    assert all((v[..., 1] - v[..., 0]).abs().max() > 1e-3 for v in expected.value)
    for part, other in zip(compiled, expected, strict=True):
        for own, wanted in zip(part, other, strict=True):
            torch.testing.assert_close(own, wanted, rtol=1e-8, atol=1e-9)


def test_what_a_tree_says_that_it_rolls_is_what_its_loop_knows(arm):
    rollout = arm.rollout(arm.default_parameters())
    for placed in effects_of(arm).values():
        effect = placed.effect
        if effect.place == "load" and not effect.steady:
            assert arm.rolls(effect) == rollout.knows(effect.name), placed.name


@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_compiled_rollout_takes_the_pieces_of_steps_at_which_commands_jump(arm, jitter, monkeypatch):
    rng = np.random.default_rng(11)
    system = ExtendedSystem(arm, ("actuation_delay(cart)", "load_friction(shoulder)", "sensing_delay"))
    stamps = np.arange(0.0, 3.0, STEP)
    commands = rng.uniform(-1.0, 1.0, (len(stamps), 2)) * [4.0, 0.8]
    stamps = stamps + rng.uniform(-jitter, jitter, len(stamps))
    windows = replace(three_windows(arm, rng), commands=(CommandSeries(stamps, commands),))
    values = {p.name: torch.full((LANES,), p.value, dtype=torch.float64) for p in system.parameters}
    late = torch.linspace(0.0, 0.006, LANES, dtype=torch.float64)
    values |= {"actuation_delay(cart).delay": late, "sensing_delay.delay": 0.3 * late.flip(0)}
    values["load_friction(shoulder).coefficient"] = 5.0 * late
    start = torch.from_numpy(0.3 * rng.normal(size=(LANES, 3, 6)))
    start[:, 0, 3:] = 0.0  # all joints rest
    compiled = integrate(system, windows, values, start)
    assert system.rollout(values) is not None
    steps_in_torch(monkeypatch)
    expected = integrate(system, windows, values, start)
    for part, other in zip(compiled, expected, strict=True):
        for own, wanted in zip(part, other, strict=True):
            torch.testing.assert_close(own, wanted, rtol=1e-7, atol=1e-8)


def test_one_push_may_act_on_all_lanes(arm, monkeypatch):
    rng = np.random.default_rng(4)
    windows = three_windows(arm, rng)
    values = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in arm.parameters}
    start = torch.from_numpy(rng.normal(size=(LANES, 3, 6)) * [0.1, 0.5, 0.5, 0.3, 1.0, 1.0])
    push = torch.zeros(3, 1, 3, windows.steps, dtype=torch.float64)
    push[1, 0, :, 20:40] = 2.0
    one = integrate(arm, windows, values, start, push)
    every = integrate(arm, windows, values, start, push.expand(3, LANES, 3, windows.steps))
    steps_in_torch(monkeypatch)
    slow = integrate(arm, windows, values, start, push)
    for a, b, c in zip(one.value, every.value, slow.value, strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=0.0)
        torch.testing.assert_close(a, c, rtol=1e-6, atol=1e-8)


def test_efforts_that_all_lanes_share_move_them_as_their_own_do(arm):
    rng = np.random.default_rng(6)
    windows, lanes, steps = 3, 7, 25
    rollout = arm.rollout({p.name: torch.tensor(p.value, dtype=torch.float64) for p in arm.parameters})
    start = torch.from_numpy(rng.normal(size=(6, windows, lanes))).unbind(0)
    one = [torch.from_numpy(rng.normal(size=(steps, windows, 1))) for _ in range(4)]
    shared = [x.expand(-1, -1, lanes) for x in one]
    friction = friction_of(arm, arm.default_parameters(), None)
    found = [
        rollout.run(
            RolloutInput(
                STEP, start, torch.zeros(windows, 1, dtype=torch.float64), each[:2], each[2:], None, friction
            )
        )
        for each in (shared, [x.clone(memory_format=torch.contiguous_format) for x in shared])
    ]
    for a, b in zip(found[0].value, found[1].value, strict=True):
        assert torch.equal(a, b)


def test_effects_that_remember_the_way_of_a_joint_have_no_compiled_rollout(arm):
    system = ExtendedSystem(arm, ("bristle(shoulder)",))
    assert system.rollout(system.default_parameters()) is None


def test_rollout_leaves_gradients_to_torch(arm):
    values = {n: v.clone().requires_grad_() for n, v in arm.default_parameters().items()}
    assert arm.rollout(values) is None


def test_lanes_with_an_effect_that_the_loop_does_not_know_leave_the_others_in_it(arm, monkeypatch):
    rng = np.random.default_rng(5)
    windows = three_windows(arm, rng)
    stamps = torch.linspace(0.0, SECONDS, 9, dtype=torch.float64).expand(3, 6, 9)
    windows = replace(windows, t=stamps, value=torch.zeros(3, 6, 9, dtype=torch.float64), valid=stamps >= 0.0)
    problem = ShootingProblem(ExtendedSystem(arm, ("bristle(shoulder)", "viscous(elbow)")), windows)
    values = {p.name: p.value for p in problem.system.parameters}
    theta = np.repeat([[values.get(n, 0.0) for n in problem.names]], 4, axis=0)
    theta[1, problem.names.index("bristle(shoulder).level")] = 0.4
    theta[3, problem.names.index("viscous(elbow).change")] = 0.2
    start = torch.from_numpy(rng.normal(size=(4, 3, 6)))
    none = problem.nuisances.none().repeat(4, 1)
    run, lanes = TreeRollout.run, []
    monkeypatch.setattr(
        TreeRollout, "run", lambda self, given: lanes.append(given.start[0].shape[1]) or run(self, given)
    )
    found = problem.predict(theta, start, none)
    assert lanes == [3]
    for k in range(4):
        alone = problem.predict(theta[[k]], start[[k]], none[[k]])
        torch.testing.assert_close(found[[k]], alone, rtol=1e-9, atol=1e-9)


def test_rollout_is_compiled_once_for_any_number_of_lanes(arm):
    windows = three_windows(arm, np.random.default_rng(7))
    for lanes in (1, 2):
        for spread in (0.0, 0.1):
            values = {n: v + spread * v * torch.arange(lanes) for n, v in arm.default_parameters().items()}
            start = torch.zeros(lanes, 3, 6, dtype=torch.float64)
            integrate(ExtendedSystem(arm, ()), windows, values, start)
    from deepkoco.systems.trees.rollout_kernel import tree_rollout

    assert len(tree_rollout.signatures) == 1
