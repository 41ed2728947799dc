"""One graph on three engines: the same motion on equations, in MuJoCo and on a unit."""

import math
import sys

import numpy as np
import pytest
import torch

from deepkoco.engines import (
    ENGINES,
    OBJECTS,
    Drive,
    EngineError,
    MujocoEngine,
    OdeEngine,
    ResetError,
    UnitEngine,
    damp,
    find_object,
    make_graph,
)
from deepkoco.graph import BatchedRuntime, draw_timing
from deepkoco.graph.live import SimulatedRuntime, WallClockRuntime
from deepkoco.systems import make_system
from deepkoco.unit import make_unit

SECONDS, RATE = 1.5, 20.0
STEPS = int(SECONDS * RATE)
# Amplitudes that move each object by about a turn, and the start state.
DRIVES = {"rod_pendulum": 2.0, "pendulum": 2.0, "torque_pendulum": 3.0}
START = (2.5, 0.5)


def needs_mujoco(engine):
    if engine == "mujoco" or isinstance(engine, MujocoEngine):
        pytest.importorskip("mujoco")


def commands(name: str) -> torch.Tensor:
    time = torch.arange(STEPS, dtype=torch.float64) / RATE
    return DRIVES[name] * torch.sign(torch.sin(5.0 * time))


def motion(name: str, engine, values=None, start=START, **delays) -> np.ndarray:
    """What the agent sees and the state at its ticks, (steps, 2, 2)."""
    needs_mujoco(engine)
    graph = make_graph(name, engine, control_rate=RATE, **delays)
    own = {"start": torch.tensor(start, dtype=torch.float64)}
    own |= {key: torch.tensor(value, dtype=torch.float64) for key, value in (values or {}).items()}
    nominal = make_system(name).default_parameters() | own
    timing = draw_timing(graph, np.random.default_rng(0), STEPS, 1)
    seen = []
    with SimulatedRuntime(graph, timing) as runtime:
        state, inputs = runtime.reset({"world": nominal, "sensor": nominal}, torch.Generator().manual_seed(0))
        for command in commands(name):
            state, inputs = runtime.step(state, command.reshape(1, 1))
            seen.append(torch.cat([inputs["sensor"].data[0, -1:], inputs["truth"].data[0, -1:]]).numpy())
    return np.array(seen)


def exact_unit(name: str) -> UnitEngine:
    """A unit whose sensor neither adds noise nor is slow, so that only the machine is left."""
    channels = {channel.name: 0.0 for channel in make_system(name).measurements}
    sensor = {"rate_hz": 1000.0, "noise_sd": channels}
    return UnitEngine(unit=make_unit(name, sensor=sensor), clock="simulated", world_rate=500.0)


@pytest.mark.parametrize(
    ("name", "tolerance"), [("rod_pendulum", 1e-6), ("torque_pendulum", 1e-6), ("pendulum", 2e-3)]
)
def test_mujoco_moves_as_the_equations_say(name: str, tolerance: float):
    """Largest difference in angle [rad] over 1.5 s; dry friction, held over a step of 1 ms, costs the disk more."""
    ours, theirs = (motion(name, engine) for engine in (OdeEngine(world_rate=200.0), MujocoEngine(200.0)))
    assert np.ptp(ours[:, 1, 0]) > 1.0
    np.testing.assert_allclose(theirs[..., 0], ours[..., 0], atol=tolerance)
    np.testing.assert_allclose(theirs[..., 1], ours[..., 1], atol=30 * tolerance)


def test_mujoco_takes_the_parameters_of_the_episode():
    values = {"mass": 1.3, "length": 0.8, "viscous": 0.2, "gravity": 9.0}
    ours, theirs = (motion("rod_pendulum", engine, values) for engine in ("ode", "mujoco"))
    np.testing.assert_allclose(theirs[..., 0], ours[..., 0], atol=1e-6)
    assert np.abs(ours - motion("rod_pendulum", "ode")).max() > 0.1


@pytest.mark.parametrize("name", sorted(DRIVES))
def test_a_unit_moves_as_the_equations_say(name: str):
    """The unit's code shares nothing with ours; commands wait for its end of the line, one tick of 2 ms."""
    ours = motion(name, OdeEngine(world_rate=500.0), actuation_delay=0.002)
    theirs = motion(name, exact_unit(name))
    np.testing.assert_allclose(theirs[..., 0], ours[..., 0], atol=1e-4)


@pytest.mark.parametrize("engine", ["ode", "mujoco"])
def test_an_actuation_delay_finer_than_a_tick_means_the_same(engine):
    delayed = motion("rod_pendulum", engine, actuation_delay=0.0137)
    prompt = motion("rod_pendulum", engine)
    reference = motion("rod_pendulum", OdeEngine(world_rate=1000.0), actuation_delay=0.0137)
    np.testing.assert_allclose(delayed[..., 0], reference[..., 0], atol=1e-3)
    assert np.abs(delayed - prompt).max() > 0.02


def test_the_ode_engine_runs_thousands_at_once_as_one_by_one():
    graph = make_graph("rod_pendulum", "ode", control_rate=RATE)
    starts = torch.tensor([[2.5, 0.5], [0.1, 0.0], [-1.0, 3.0]], dtype=torch.float64)
    nominal = make_system("rod_pendulum").default_parameters() | {"start": starts}
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), STEPS, 3))
    state, inputs = runtime.reset({"world": nominal, "sensor": nominal}, torch.Generator())
    for command in commands("rod_pendulum"):
        state, inputs = runtime.step(state, command.expand(3, 1))
    for b, start in enumerate(starts.tolist()):
        alone = motion("rod_pendulum", "ode", start=start)
        np.testing.assert_allclose(inputs["truth"].data[b, -1], alone[-1, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("state", "command", "message"),
    [((1.0, math.nan), 0.0, "state is not finite"), ((1.0, 0.0), math.nan, "command nan is not finite")],
)
def test_mujoco_stops_at_what_is_no_number(state, command, message, tmp_path, monkeypatch):
    """By itself it would put the body back to zero, drop the command, and go on."""
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)  # it writes a log where it is
    world = MujocoEngine().nodes(find_object("rod_pendulum").dynamics)[0]
    world.init({}, torch.Generator(), 1)
    with pytest.raises(EngineError, match=message):
        world._simulator.advance(list(state), command, 10)


def test_an_episode_in_mujoco_repeats_bit_for_bit():
    assert motion("pendulum", "mujoco").tobytes() == motion("pendulum", "mujoco").tobytes()


@pytest.mark.parametrize("engine", [MujocoEngine(), UnitEngine(clock="simulated")], ids=["mujoco", "unit"])
def test_a_machine_that_is_held_runs_in_one_environment(engine):
    needs_mujoco(engine)
    world = make_graph("rod_pendulum", engine).node("world")
    assert not world.pure
    with pytest.raises(EngineError, match="not 2"):
        world.init({}, torch.Generator(), 2)


def test_without_mujoco_the_package_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(EngineError, match='pip install "mujoco'):
        make_graph("rod_pendulum", "mujoco")


def test_objects_name_their_actuators_and_sensors():
    for name, robot in OBJECTS.items():
        assert robot.system == name
        assert [channel.kind for channel in robot.actuators] == ["command"]
        assert [channel.name for channel in robot.sensors] == ["theta", "omega"]
    mujoco = pytest.importorskip("mujoco")
    world = MujocoEngine().nodes(find_object("pendulum").dynamics)[0]
    world.init({}, torch.Generator(), 1)
    model = world._simulator.model
    names = [model.actuator(0).name, *(model.sensor(i).name for i in range(2))]
    assert names == ["voltage", "theta", "omega"]
    assert mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, 0) == "hinge"


def test_noise_is_the_sensors_whatever_the_engine():
    clean, noisy = (motion("rod_pendulum", OdeEngine(noise=noise)) for noise in (False, True))
    assert (clean[:, 1] == noisy[:, 1]).all()
    spread = (noisy - clean)[:, 0].std(0)
    np.testing.assert_allclose(spread, [0.002, 0.05], rtol=0.4)


def hanging(engine, start=(math.pi, 0.0)) -> tuple[np.ndarray, float]:
    """Two episodes of a unit that swings at first: what the second one starts with, and when."""
    graph = make_graph("rod_pendulum", engine, control_rate=RATE)
    parameters = {"world": {"start": torch.tensor(start)}, "sensor": {"start": torch.tensor(start)}}
    timing = draw_timing(graph, np.random.default_rng(0), 20, 1)
    with SimulatedRuntime(graph, timing) as runtime:
        generator = torch.Generator().manual_seed(0)
        for _ in range(2):
            state, inputs = runtime.reset(parameters, generator)
            first = inputs["truth"].data[0, -1].numpy()
            for _ in range(20):
                state, _ = runtime.step(state, torch.tensor([[2.0]], dtype=torch.float64))
        return first, graph.node("world")._unit.now()


def test_a_reset_node_drives_the_unit_to_its_start_between_episodes():
    first, now = hanging(UnitEngine(clock="simulated", reset=Drive(damp(1.0))))
    assert abs(math.remainder(first[0] - math.pi, math.tau)) < 0.15
    assert abs(first[1]) < 0.4
    assert now > 2.5  # two episodes of a second, and the way back in between


def test_a_start_out_of_reach_is_told():
    reset = Drive(damp(1.0), timeout=1.0)
    with pytest.raises(Exception, match=r"rad and .* rad/s away from its start after 1 s") as caught:
        hanging(UnitEngine(clock="simulated", reset=reset), start=(0.0, 0.0))
    assert isinstance(caught.value, ResetError) or isinstance(caught.value.__cause__, ResetError)


@pytest.mark.timeout(60)
def test_a_unit_in_its_own_process_runs_by_the_clock_and_is_stopped():
    graph = make_graph("rod_pendulum", "unit", control_rate=RATE)
    start = {"start": torch.tensor([math.pi, 0.0], dtype=torch.float64)}
    with WallClockRuntime(graph, threads=["world", "sensor"]) as runtime:
        runtime.reset({"world": start, "sensor": start}, torch.Generator().manual_seed(0))
        runtime.run(lambda seen: torch.tensor([[2.0]], dtype=torch.float64), 12)
        episode = runtime.finish()
        angle = episode.outputs["world"][:, 0]
    # Half a second of 2 N m from hanging: 3 u / (m l^2) = 6 rad/s2 against gravity.
    assert 0.1 < abs(angle[-1] - math.pi) < 1.0
    assert graph.node("world")._unit is None


def test_the_graph_is_the_same_but_for_the_engines_nodes():
    shapes = [
        [(c.key, c.window, c.skip) for c in make_graph("pendulum", engine).connections]
        for engine in (OdeEngine(), MujocoEngine(), UnitEngine())
    ]
    assert shapes[0] == shapes[1] == shapes[2]
    assert sorted(ENGINES) == ["mujoco", "ode", "unit"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("lamp", "ode"), 'no object "lamp"; known: rod_pendulum, pendulum'),
        (("pendulum", "clay"), 'no engine "clay"; known: ode, mujoco, unit'),
        (
            ("pendulum", UnitEngine(unit=make_unit("rod_pendulum"))),
            "is a rod_pendulum, the object a pendulum",
        ),
    ],
)
def test_wrong_names_are_told(arguments, message):
    with pytest.raises(EngineError, match=message):
        make_graph(*arguments)
    with pytest.raises(EngineError, match='clock "sand" is none of wall, simulated'):
        UnitEngine(clock="sand")
