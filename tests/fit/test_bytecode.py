"""Simulations by bytecode, against the same equations in torch: built-in systems, effects, classes of users."""

import gc
import math
import weakref

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco import Channel, Parameter, System
from deepkoco.fit.data.noise import Noise
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.simulate import simulator
from deepkoco.fit.simulate.bytecode import along_windows as lanes_of
from deepkoco.fit.simulate.bytecode.along_windows import PLACES, has_program
from deepkoco.fit.simulate.bytecode.machine import BLOCK, execute
from deepkoco.fit.simulate.bytecode.translate import Nodes, Rows, instructions, translated
from deepkoco.fit.simulate.simulator import integrate
from deepkoco.graph.execution.fused.trace import TraceError, trace
from deepkoco.systems import ExtendedSystem, any_system, make_system
from deepkoco.systems.effects import effects_of

STEP, STEPS, LANES = 0.001, 200, 5
SYSTEMS = ("rod_pendulum", "pendulum", "servo_pendulum", "quadrotor_height", "two_link_arm")


def windows_of(system, rng, count=3):
    stamps = np.arange(0.0, 3.0, 0.05)
    sizes = [min(abs(c.high), 2.0) for c in system.commands]
    commands = CommandSeries(stamps, rng.uniform(-1.0, 1.0, (len(stamps), len(sizes))) * sizes)
    none = torch.zeros(count, len(system.measurements), 0, dtype=torch.float64)
    return Windows(
        (commands,),
        np.zeros(count, dtype=int),
        np.linspace(0.5, 2.0, count),
        STEP,
        STEPS,
        none,
        none,
        none.bool(),
        tuple(Noise(0.01, 0.0) for _ in system.measurements),
        torch.zeros(count, 2 * system.joints, dtype=torch.float64),
        np.zeros(count, dtype=bool),
    )


def drawn(system, rng, lanes=LANES):
    return {
        p.name: torch.from_numpy(np.clip(p.value + p.prior_sd * rng.uniform(0.0, 1.0, lanes), p.low, p.high))
        for p in system.parameters
    }


def started(system, rng, lanes=LANES, count=3):
    start = torch.from_numpy(rng.normal(size=(lanes, count, 2 * system.joints)))
    start[:, 0, system.joints :] = 0.0  # all joints rest
    return start


def both(monkeypatch, system, windows, *arguments):
    """Nodes by bytecode and in torch; fails where torch stood in for bytecode."""
    in_torch = simulator.in_torch
    with monkeypatch.context() as alone:
        alone.setattr(simulator, "in_torch", lambda *_: pytest.fail("no bytecode"))
        fast = integrate(system, windows, *arguments)
    with monkeypatch.context() as alone:
        alone.setattr(simulator, "along_windows", lambda *_: None)
        slow = integrate(system, windows, *arguments)
    assert simulator.in_torch is in_torch
    return fast, slow


def assert_same(fast, slow, rtol=1e-8, atol=1e-9):
    for part, other in zip(fast, slow, strict=True):
        for own, wanted in zip(part, other, strict=True):
            torch.testing.assert_close(own, wanted, rtol=rtol, atol=atol)


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_effect_in_the_equations_moves_a_system_as_in_torch(name, monkeypatch):
    base = make_system(name)
    kinds = {n: e for n, e in effects_of(base).items() if e.effect.place in PLACES}
    assert len(kinds) > 5
    for number, effect in enumerate(kinds):
        rng = np.random.default_rng(number)
        system = ExtendedSystem(base, (effect,))
        pushed = torch.from_numpy(rng.normal(size=(base.joints, LANES, 3, STEPS))) if number % 2 else None
        arguments = drawn(system, rng), started(system, rng), pushed
        assert_same(*both(monkeypatch, system, windows_of(base, rng), *arguments))


TWO_LINKS = """
<mujoco>
  <worldbody>
    <body>
      <joint name="shoulder" axis="0 1 0" damping="0.1" frictionloss="0.3" armature="0.05"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.8"/>
      <body pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.05" frictionloss="0.15" armature="0.02"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize("effects", [["bristle(elbow)"], ["lugre(shoulder)", "stribeck(shoulder)"]], ids=str)
@pytest.mark.parametrize("engine", ["MuJoCo", "semi-implicit"])
def test_memories_act_beside_the_friction_of_an_engine_as_in_torch(engine, effects, monkeypatch, tmp_path):
    (tmp_path / "arm.xml").write_text(TWO_LINKS)
    arm = any_system(tmp_path / "arm.xml").with_engine(engine, STEP)
    rng, system = np.random.default_rng(4), ExtendedSystem(arm, effects)
    windows = windows_of(system, rng)
    for k in range(len(windows)):
        # In torch all lanes of a window take the step of the one that turns, so each is simulated alone.
        alone, values, start = (
            windows.take(np.array([k])),
            drawn(system, rng, 1),
            started(system, rng, 1)[:, k : k + 1],
        )
        assert values[f"{effects[0]}.level"] > 0.0
        fast, slow = both(monkeypatch, system, alone, values, start)
        assert_same(fast, slow)
        assert any(bool((v[1:] * v[:-1] <= 0.0).any()) for v in fast.value[2:])  # joints turn or rest


def test_effects_act_in_their_lanes_alone(monkeypatch):
    rng = np.random.default_rng(1)
    base = make_system("rod_pendulum")
    system = ExtendedSystem(base, ("coulomb", "bristle", "spring", "gain"))
    values = drawn(system, rng)
    nulls = {p.name: p.value for p in system.parameters if "." in p.name}
    lanes = {"coulomb": slice(1, 3), "spring": slice(2, 4), "gain": slice(0, 2), "bristle": slice(4, 5)}
    for name, null in nulls.items():
        part = lanes[name.split(".")[0]]
        outside = torch.ones(LANES, dtype=torch.bool)
        outside[part] = False
        values[name][outside] = null
    arguments = values, started(system, rng), None, lanes
    fast, slow = both(monkeypatch, system, windows_of(base, rng), *arguments)
    # Torch gives a joint that turns its mean acceleration in all lanes, with dry friction or without.
    for own, wanted in zip(fast.value, slow.value, strict=True):
        torch.testing.assert_close(own, wanted, rtol=1e-8, atol=1e-9)


def test_an_effect_without_a_program_leaves_the_lanes_of_others_compiled(monkeypatch):
    rng = np.random.default_rng(9)
    base = make_system("rod_pendulum")
    system = ExtendedSystem(base, ("spring", "gain"))
    lanes = {"spring": slice(1, 3)}
    values = drawn(system, rng)
    for p in system.parameters:
        if p.name.startswith("spring."):
            values[p.name][[0, 3, 4]] = p.value
    known = lanes_of._known

    def none_with_a_spring(acting, *given):
        return None if "spring" in [e.name for e in acting.effects] else known(acting, *given)

    monkeypatch.setattr(lanes_of, "_known", none_with_a_spring)
    assert_same(*both(monkeypatch, system, windows_of(base, rng), values, started(system, rng), None, lanes))


def test_a_lane_moves_the_same_to_the_last_bit_whatever_is_simulated_beside_it():
    rng = np.random.default_rng(2)
    base = make_system("servo_pendulum")
    system = ExtendedSystem(base, ("coulomb", "load_friction"))
    many = 2 * BLOCK // 3 + 7
    values, start, windows = drawn(system, rng, many), started(system, rng, many), windows_of(base, rng)
    every = integrate(system, windows, values, start)
    for lane in (0, many // 2, many - 1):
        own = {n: v[lane : lane + 1] for n, v in values.items()}
        one = integrate(system, windows, own, start[lane : lane + 1])
        assert all(torch.equal(a[..., 0], b[..., lane]) for a, b in zip(one.value, every.value, strict=True))


def test_a_lane_that_diverges_leaves_the_others_as_they_are():
    rng = np.random.default_rng(3)
    system = ExtendedSystem(make_system("rod_pendulum"), ("coulomb",))
    values, start, windows = drawn(system, rng), started(system, rng), windows_of(system, rng)
    calm = integrate(system, windows, values, start)
    start[2] = math.nan
    wild = integrate(system, windows, values, start)
    kept = [0, 1, 3, 4]
    assert all(torch.equal(a[..., kept], b[..., kept]) for a, b in zip(calm.value, wild.value, strict=True))
    assert bool(torch.isnan(wild.value[0][..., 2]).all())


def test_parameters_that_differ_from_log_to_log_have_values_of_their_own(monkeypatch):
    rng = np.random.default_rng(4)
    system = ExtendedSystem(make_system("rod_pendulum"), ("coulomb",))
    windows = windows_of(system, rng)
    differ = {"mass": torch.tensor([[0.02]], dtype=torch.float64)}
    arguments = drawn(system, rng), started(system, rng), None, None, differ
    fast, slow = both(monkeypatch, system, windows, *arguments)
    assert_same(fast, slow)
    assert not torch.equal(fast.value[0], integrate(system, windows, *arguments[:2]).value[0])


def test_gradients_flow_through_the_steps_in_torch():
    rng = np.random.default_rng(5)
    system = make_system("rod_pendulum")
    values = {n: v.requires_grad_() for n, v in drawn(system, rng).items()}
    nodes = integrate(system, windows_of(system, rng), values, started(system, rng))
    nodes.value[0].sum().backward()
    assert bool((values["length"].grad != 0.0).all())


class Coupled(System):
    """Two carts with a spring, as matrices: equations as users write them."""

    joint_units = ("m", "m")
    parameters = (
        Parameter("mass", 1.0, "kg", 0.1, 10.0, 0.1, "m"),
        Parameter("stiffness", 4.0, "N/m", 0.0, 100.0, 1.0, "k"),
    )
    commands = (Channel("force", "N", "command", -5.0, 5.0),)
    measurements = (Channel("position", "m", "measurement", noise_sd=1e-3),)
    calls = None

    def accelerations(self, p):
        def law(motion):
            x = torch.stack(torch.broadcast_tensors(*motion.angles), -1)
            coupling = torch.tensor([[-1.0, 1.0], [1.0, -1.0]], dtype=torch.float64)
            pull = torch.einsum("ij,...j->...i", coupling, x) * torch.as_tensor(p["stiffness"])[..., None]
            first, second = pull.unbind(-1)
            first = first + torch.where(motion.efforts[0].abs() > 0.1, motion.efforts[0], 0.0)
            return ((first + motion.load(0)) / p["mass"], (second + motion.load(1)).pow(3) / p["mass"])

        return law


class Deciding(Coupled):
    """Equations that Python decides by values; no trace can follow."""

    def accelerations(self, p):
        def law(motion):
            push = motion.efforts[0] if bool((motion.efforts[0] > 0.0).any()) else -motion.efforts[0]
            return ((push + motion.load(0)) / p["mass"], motion.angles[0] * 0.0 + motion.load(1))

        return law


class Counting(Coupled):
    """Equations that are others at each call, once they are counted."""

    def accelerations(self, p):
        def law(motion):
            self.calls = None if self.calls is None else self.calls + 1
            push = motion.efforts[0] * (self.calls or 1) + motion.load(0)
            return (push / p["mass"], motion.angles[0] * 0.0 + motion.load(1))

        return law


def test_equations_of_users_may_use_matrices(monkeypatch):
    rng = np.random.default_rng(6)
    system = Coupled()
    assert_same(*both(monkeypatch, system, windows_of(system, rng), drawn(system, rng), started(system, rng)))


@pytest.mark.parametrize("kind", [Deciding, Counting])
def test_equations_that_no_trace_can_follow_are_left_to_torch(kind, monkeypatch):
    rng = np.random.default_rng(7)
    system, called = kind(), []
    system.calls = 0
    in_torch = simulator.in_torch
    monkeypatch.setattr(simulator, "in_torch", lambda *given: called.append(1) or in_torch(*given))
    integrate(system, windows_of(system, rng), drawn(system, rng), started(system, rng))
    assert called


class Winch(System):
    """A rotor so light that large effects make its steps diverge."""

    joint_units = ("rad",)
    parameters = (
        Parameter("inertia", 9e-5, "kg m2", 1e-6, 1e-2, 3e-6, "J"),
        Parameter("damping", 6e-5, "N m s/rad", 0.0, 0.01, 2e-5, "b"),
    )
    commands = (Channel("current", "A", "command", -12.0, 12.0),)
    measurements = (Channel("angle", "rad", "measurement", noise_sd=1e-3),)

    def accelerations(self, p):
        def law(motion):
            torque = 0.05 * motion.efforts[0] - p["damping"] * motion.speeds[0] + motion.load(0)
            return (torque / p["inertia"],)

        return law


def test_programs_are_compared_where_the_motion_is_moderate():
    # Torch and bytecode round the sine of an angle of 1e80 rad differently, which says nothing of the program.
    assert has_program(ExtendedSystem(Winch(), ("stribeck", "quadratic", "cogging")), 0.01)


def computed(function, *inputs):
    """Result of a function of tensors (N,), as bytecode."""
    nodes, pool, rows = Nodes(), Rows(), {}
    names = [f"x{k}" for k in range(len(inputs))]
    places = {n: nodes.add(("input", n)) for n in names}
    one = {n: torch.full((1, 1), 0.5, dtype=torch.float64) for n in names}
    found = translated(nodes, trace(lambda x: {"y": function(*(x[n] for n in names))}, one), places)
    wanted = nodes.copy(found["y"])
    done = {k for k, node in enumerate(nodes.listed) if node[0] in ("input", "constant")}
    rows |= {k: pool.take() for k in sorted(done)}
    code = instructions(nodes, [wanted], rows, done, pool)
    table = np.zeros((pool.count, len(inputs[0])))
    for k in done:
        node = nodes.listed[k]
        table[rows[k]] = inputs[names.index(node[1])] if node[0] == "input" else node[2]
    execute(code, table, len(inputs[0]))
    return table[rows[wanted]]


OPERATIONS = {
    "arithmetic": lambda a, b: (2.0 - a) * b / (a.square() + 1.0) - torch.rsub(a, b, alpha=3),
    "powers": lambda a, b: a**2 + a**3 + (a.abs() + 0.1) ** 0.5 + (b.square() + 0.1) ** -1.5 + 2.0**b,
    "circles": lambda a, b: (
        torch.sin(a) * torch.cos(b) + torch.tan(0.1 * a) + torch.atan2(a, b) + torch.atan(b)
    ),
    "hyperbolas": lambda a, b: torch.tanh(a) + torch.sinh(0.1 * b) + torch.cosh(0.1 * a) + torch.sigmoid(b),
    "exponentials": lambda a, b: (
        torch.exp(0.1 * a) + torch.expm1(0.1 * b) + torch.log1p(a.abs()) + torch.erf(b)
    ),
    "bounds": lambda a, b: a.clamp(-1.0, 1.0) + b.clamp_min(0.2) + a.clamp(max=0.3) + torch.relu(b),
    "choices": lambda a, b: torch.where((a > b) & ~(a > 1.0) | (b == a), a, -b) + torch.maximum(a, b).floor(),
    "signs": lambda a, b: torch.sign(a) * b.abs() + torch.minimum(a, b).ceil() + (a != b).to(torch.float64),
    "sums": lambda a, b: (
        torch.stack([a, b, a * b], -1).sum(-1) + torch.cat([a, b], -1).mean(-1, keepdim=True)
    ),
    "three": lambda a, b: (
        torch.addcmul(a, a, b, value=2.0) + torch.addcdiv(b, a, b.square() + 1.0, value=-1.0)
    ),
    "roots": lambda a, b: (
        torch.rsqrt(a.square() + 1.0) + torch.reciprocal(b.square() + 1.0) + torch.log(a.abs() + 1.0)
    ),
}
NUMBERS = st.lists(st.floats(-5.0, 5.0), min_size=4, max_size=4)


@settings(max_examples=25, deadline=None)
@given(NUMBERS, NUMBERS)
@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_give_what_torch_gives(name, a, b):
    function = OPERATIONS[name]
    x, y = (torch.tensor(v, dtype=torch.float64)[:, None] for v in (a, b))
    wanted = function(x, y)[:, 0].numpy()
    np.testing.assert_allclose(computed(function, np.array(a), np.array(b)), wanted, rtol=1e-12, atol=1e-12)


def test_an_operation_that_mixes_simulations_is_refused():
    with pytest.raises(TraceError, match="no instruction"):
        computed(lambda a: torch.linalg.inv(a.reshape(1, 1, 1)).reshape(1, 1), np.ones(2))


def test_not_a_number_is_kept_by_bounds_and_signs():
    found = computed(
        lambda a: torch.sign(a) + a.clamp(-1.0, 1.0) + torch.maximum(a, -a), np.array([math.nan, 0.5])
    )
    assert math.isnan(found[0])
    assert found[1] == 2.0


def test_programs_do_not_keep_a_system_alive():
    rng = np.random.default_rng(8)
    base = make_system("rod_pendulum")
    system = ExtendedSystem(base, ("coulomb", "spring"))
    integrate(
        system, windows_of(base, rng), drawn(system, rng), started(system, rng), None, {"spring": slice(1, 3)}
    )
    kept = weakref.ref(base)
    del base, system
    gc.collect()
    assert kept() is None
