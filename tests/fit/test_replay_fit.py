"""A recording of a unit without any world: replayed with a simulated world, and fitted."""

import numpy as np
import pytest
import torch

from deepkoco.engines import UnitEngine, make_graph
from deepkoco.engines.ode import World
from deepkoco.engines.sensor import Sensor
from deepkoco.fit import FitError
from deepkoco.fit.graph_fit import fit_replay
from deepkoco.graph import (
    Connection,
    Graph,
    Node,
    Supervisor,
    draw_timing,
    read_episodes,
    replay_record,
    write_episodes,
)
from deepkoco.graph.live import SimulatedRuntime, WallClockRuntime
from deepkoco.systems import make_system
from deepkoco.unit import SimulatedUnit, make_unit

F64 = torch.float64
TRUE = {"mass": 1.15, "viscous": 0.13}
DELAY = 0.0234
NOISE = (0.002, 0.05)


class Line:
    """The line to a unit in virtual time; both of its ends hold it."""

    def __init__(self) -> None:
        effects = {"actuation_delay": {"delay": DELAY}}
        sensor = {"rate_hz": 1000.0}
        self.unit = SimulatedUnit(make_unit("rod_pendulum", parameters=TRUE, effects=effects, sensor=sensor))
        self.measured = self.unit.receive().values

    def go_to(self, time: float) -> None:
        while (message := self.unit.poll(max(0.0, time - self.unit.now()))) is not None:
            self.measured = message.values


class Motor(Node):
    """Sends the newest command to the unit."""

    inputs = ("agent",)
    pure = False

    def __init__(self, line: Line) -> None:
        super().__init__("motor", 50)
        self.line = line

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1, dtype=F64)

    def step(self, parameters, state, inputs):
        self.line.go_to(float(inputs["agent"].t_start[0]))
        command = inputs["agent"].data[:, -1]
        self.line.unit.send(float(command))
        return state, command


class Encoder(Node):
    """Reads what the unit has measured last."""

    pure = False

    def __init__(self, line: Line) -> None:
        super().__init__("sensor", 100)
        self.line = line

    def init(self, parameters, generator, batch):
        return {"tick": torch.zeros(batch, dtype=torch.int64)}

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 2, dtype=F64)

    def step(self, parameters, state, inputs):
        self.line.go_to(float(state["tick"]) / 100)
        return {"tick": state["tick"] + 1}, torch.tensor([self.line.measured], dtype=F64)


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """Six seconds of a pendulum at random torques, as a file: commands, measurements and times, but no world."""
    line = Line()
    agent = Supervisor("agent", 20, initial_action=torch.zeros(1, dtype=F64))
    graph = Graph(
        [Encoder(line), agent, Motor(line)],
        [
            Connection("sensor", "agent", {"law": "gaussian", "loc": 0.008, "scale": 0.002}),
            Connection("agent", "motor", {"law": "uniform", "low": 0.002, "high": 0.012}),
        ],
    )
    generator = torch.Generator().manual_seed(4)
    with SimulatedRuntime(graph, draw_timing(graph, np.random.default_rng(5), 120, 1)) as runtime:
        runtime.reset({}, generator)
        runtime.run(lambda seen: 3.0 * (2.0 * torch.rand(1, 1, generator=generator, dtype=F64) - 1.0), 120)
        episode = runtime.finish()
    path = tmp_path_factory.mktemp("record") / "unit.mcap"
    write_episodes(path, graph, [episode])
    return read_episodes(path)


def with_world(record, delay=0.0):
    system = make_system("rod_pendulum")
    return replay_record(
        record,
        add=[World(system, 200.0), Sensor(system, 100.0, (0.0, 0.0))],
        connect=[
            Connection("motor", "world", delay, window=3, skip=True, name="agent"),
            Connection("world", "sensor"),
        ],
    )


def start() -> dict[str, dict[str, torch.Tensor]]:
    hanging = {"start": torch.tensor([[np.pi, 0.0]], dtype=F64)}
    return {"world": make_system("rod_pendulum").default_parameters() | hanging, "sensor": hanging}


def test_two_parameters_and_a_hidden_delay_are_found_in_a_recording_without_a_world(record):
    key = "motor->world:agent"
    sought = {"world.mass": (0.5, 2.0), "world.viscous": (0.0, 0.5), key: (0.0, 0.06)}
    result = fit_replay(
        with_world(record), start(), sought, {"sensor": np.array(NOISE)}, population=16, generations=60
    )
    for name, value in TRUE.items():
        assert result.estimates[f"world.{name}"].value == pytest.approx(value, rel=0.02)
    assert result.estimates[key].value == pytest.approx(DELAY, abs=1e-3)
    assert result.estimates[key].unit == "s"
    assert result.convergence.stages[0][1][-1] == pytest.approx(
        2 * 6 * 100, rel=0.15
    )  # a noise variance a sample


@pytest.mark.parametrize(
    ("sought", "noise", "message"),
    [
        (
            {"agent->motor": (0.0, 0.1)},
            {"sensor": 0.1},
            '"agent->motor" was measured: only delays of what was added',
        ),
        ({"motor->world:agent": (-0.1, 0.1)}, {"sensor": 0.1}, "a delay is not below 0"),
        ({"world.mass": (0.1, 1.0)}, {"camera": 0.1}, 'noise_sd "camera": compared are sensor'),
        ({"world.mass": (0.1, 1.0)}, {"sensor": np.ones(3)}, 'noise_sd "sensor": .* does not fit'),
        ({"world.start[2]": (0.0, 1.0)}, {"sensor": 0.1}, '"world.start" has 2 entries'),
        ({"world.begin[0]": (0.0, 1.0)}, {"sensor": 0.1}, 'give a start value of the vector "world.begin"'),
    ],
)
def test_requests_that_do_not_fit_the_replay_are_told(record, sought, noise, message):
    with pytest.raises(FitError, match=message):
        fit_replay(with_world(record), start(), sought, noise, population=4, generations=1)


def test_an_entry_of_a_start_state_is_fitted_like_a_parameter(record):
    parameters = start()
    parameters["world"] |= {name: torch.tensor(value, dtype=F64) for name, value in TRUE.items()}
    parameters["world"]["start"] = torch.tensor([[np.pi + 0.3, 0.0]], dtype=F64)
    result = fit_replay(
        with_world(record, DELAY),
        parameters,
        {"world.start[0]": (2.0, 4.0)},
        {"sensor": np.array(NOISE)},
        population=8,
        generations=25,
    )
    assert result.estimates["world.start[0]"].value == pytest.approx(np.pi, abs=0.02)


@pytest.mark.timeout(90)
def test_a_wall_clock_recording_of_a_unit_is_replayed_on_its_measured_times():
    """The node ``world`` of the unit engine is the line to the unit: it knows no state, only measurements."""
    graph = make_graph("rod_pendulum", UnitEngine(), control_rate=20.0)
    hanging = {"start": torch.tensor([[np.pi, 0.0]], dtype=F64)}
    torques = iter(2.0 * torch.sign(torch.sin(torch.arange(20) * 0.9)).to(F64).reshape(-1, 1, 1))
    with WallClockRuntime(graph, threads=["world", "sensor"]) as runtime:
        runtime.reset({"world": hanging, "sensor": hanging}, torch.Generator().manual_seed(0))
        runtime.run(lambda seen: next(torques), 20)
        episode = runtime.finish()
    system = make_system("rod_pendulum")
    plant, measuring = World(system, 500.0), Sensor(system, 100.0, (0.0, 0.0))
    plant.name, measuring.name = "plant", "world"
    replayed = replay_record(
        (graph, episode),
        add=[plant, measuring],
        connect=[
            Connection("agent", "plant", 0.004, window=3, skip=True),  # the tick of the line, on average
            Connection("plant", "world", name="world"),
        ],
    )
    timing = replayed.timing
    for n, node in enumerate(replayed.graph.nodes):
        if node.name != "plant":
            start = timing.steps_of(n)[0] / timing.resolution
            np.testing.assert_allclose(start, episode.t_start[node.name][: len(start)], atol=1e-9)
    for e, key in enumerate(timing.layout.connections):
        if key in replayed.episode.windows:
            seen = timing.windows_of(e)
            np.testing.assert_array_equal(seen, episode.windows[key][: len(seen)])
    errors = []
    for factor in (1.0, 3.0):
        values = system.default_parameters()
        values["mass"] = factor * values["mass"]
        simulated = replayed.run({"plant": values | hanging, "world": hanging}).outputs["world"]
        measured = episode.outputs["world"][: len(simulated)]
        errors.append(float(np.sqrt(np.mean((simulated - measured)[:, 0] ** 2))))
    assert errors[0] < 0.5 * errors[1]
