"""The graph of a pool."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from deepkoco.engines.pid import Pid
from deepkoco.engines.pool import Actuator, FlowDelay, PoolWorld, Probe
from deepkoco.envs.pool.seat import LOWEST_PUMP, PoolSeat
from deepkoco.graph import Connection, Graph, Node
from deepkoco.graph.delay import Delay, make_delay
from deepkoco.graph.model.connection import wide_enough
from deepkoco.graph.model.node import State
from deepkoco.systems.fluids import pool_parameters
from deepkoco.systems.fluids.pool import HEAT_CAPACITY

if TYPE_CHECKING:
    from deepkoco.fit.state.kalman_node import KalmanNode

FILTERS = ("none", "now", "constant", "flow")
"""What a filter takes a measurement to be: no filter; of now; of a constant time ago; of a time that the flow tells."""
LONGEST_AGE = 480.0
"""At the lowest flow the pipe takes 400 s [s]."""
WORLD_RATE, CONTROL_RATE = 1.0, 0.1
STEP = 60.0  # of the filter's integration; over it the mean command is held [s]
AFTER = 1.0  # controllers run so long after the thermometer: its messages have arrived by then [s]


@dataclass(frozen=True)
class PoolOptions:
    """How a pool is measured and controlled.

    Attributes:
        filter: One of `FILTERS`.
        constant_age: What the filter "constant" takes the age of the water to be [s].
        controlled: A PID controller moves the heater, and the agent gives its goal.
        gain, integral_time, derivative_time: Of the controller: level per K, [s], [s].
        heat_noise: Of the filter: spectral density of the unknown heat [W2/s].
        noise: The thermometer has noise of 0.05 K and the flow meter of 1 %.
        history: Past actions in the agent's observation.
        sensing_delay: From the thermometer to controllers; filters know nothing of it, so beyond some seconds they take
            measurements for younger than they are.
        actuation_delay: From controllers to heater and pump.
    """

    filter: str = "none"
    constant_age: float = 60.0
    controlled: bool = False
    gain: float = 0.5
    integral_time: float = 1200.0
    derivative_time: float = 0.0
    heat_noise: float = 2e4
    noise: bool = True
    history: int = 0
    sensing_delay: Any = None
    actuation_delay: Any = None

    def __post_init__(self) -> None:
        if self.filter not in FILTERS:
            raise ValueError(f'filter = "{self.filter}"; choose one of {", ".join(FILTERS)}')
        if not 0.0 <= self.constant_age <= LONGEST_AGE:
            raise ValueError(f"constant_age = {self.constant_age} s; give 0 to {LONGEST_AGE:g} s")
        if not 0.0 < self.heat_noise < math.inf:
            raise ValueError(f"heat_noise = {self.heat_noise} W2/s; give a number above 0")


def pool_graph(options: PoolOptions | None = None) -> Graph:
    """World, heater, pump and probe; a filter and a controller where wanted; the agent.

    Args:
        options: See there.

    Raises:
        ValueError: An option is none of its values.
    """
    options = options or PoolOptions()
    sensing = _law(options.sensing_delay, {"law": "uniform", "low": 0.1, "high": 0.5})
    actuation = _law(options.actuation_delay, {"law": "uniform", "low": 0.2, "high": 0.8})
    probe = Probe(CONTROL_RATE, WORLD_RATE, *((0.05, 0.01) if options.noise else (0.0, 0.0)))
    seat = PoolSeat(CONTROL_RATE, options.history, options.controlled, phase=AFTER)
    world = PoolWorld(WORLD_RATE)
    nodes: list[Node] = [
        world,
        Actuator("heater", WORLD_RATE, 0),
        Actuator("pump", WORLD_RATE, 1, LOWEST_PUMP, idle=1.0),
        probe,
        seat,
    ]
    heats = "pid" if options.controlled else "agent"
    connections = [
        Connection("heater", "world", window=2),
        Connection("pump", "world", window=2),
        wide_enough(Connection("world", "probe"), world, probe),
        Connection("world", "agent", name="truth"),
        Connection("probe", "agent", delay=sensing),
        Connection("agent", "pump", delay=actuation, skip=True, name="command"),
        Connection(heats, "heater", delay=actuation, skip=True, name="command"),
    ]
    if options.filter != "none":
        kalman = _kalman(options)
        nodes.append(kalman)
        connections += [
            Connection("probe", "kalman", delay=sensing, name="sensor"),
            Connection("kalman", "agent"),
            Connection(
                heats,
                "kalman",
                delay=actuation,
                skip=True,
                name="command",
                window=kalman.commands_needed(CONTROL_RATE),
            ),
        ]
        if options.filter == "flow":
            volume = float(pool_parameters()["world"]["pipe_volume"])
            nodes.append(FlowDelay(CONTROL_RATE, volume, _sensor_age(), LONGEST_AGE, phase=AFTER))
            connections += [
                Connection("probe", "delay", delay=sensing, name="sensor"),
                Connection("delay", "kalman", name="age"),
            ]
    if options.controlled:
        nodes.append(
            Pid(
                "pid",
                CONTROL_RATE,
                options.gain,
                options.integral_time,
                options.derivative_time,
                low=0.0,
                high=1.0,
                measured=_temperature if options.filter == "none" else _estimate,
                phase=AFTER,
            )
        )
        source = Connection("probe", "pid", delay=sensing, name="measured")
        connections += [
            Connection("agent", "pid", name="goal"),
            source if options.filter == "none" else Connection("kalman", "pid", name="measured"),
        ]
    return Graph(nodes, connections)


def pool_start(graph: Graph, temperature: Tensor, goal: Tensor) -> dict[str, State]:
    """Start states by node in which all water has one temperature (B,) and the agent a goal (B,) [deg C].

    Args:
        graph: As `pool_graph` made it.
        temperature, goal: See above.
    """
    world, seat = graph.node("world"), graph.node("agent")
    assert isinstance(world, PoolWorld)
    assert isinstance(seat, PoolSeat)
    fresh = seat.init({}, torch.Generator(), len(temperature))
    states = {
        "world": world.start(temperature),
        "probe": {
            "temperature": temperature.clone(),
            "seen": torch.full((len(temperature),), -1, dtype=torch.int64),
        },
        "agent": {"goal": goal, "before": temperature.clone(), "actions": fresh["actions"]},
    }
    if "kalman" in graph.index:
        # As one that begins with its first measurement.
        zero = torch.zeros_like(temperature)
        states["kalman"] = {"mean": torch.stack([temperature, zero, zero], -1)}
    return states


def _kalman(options: PoolOptions) -> KalmanNode:
    """States: temperature of the pool [deg C], unknown heat [W], heat of the heater [W].

    What the pipe takes from the pool and gives back is a heat that it does not know: 2 % of the water.
    """
    # The fits are a second of imports.
    from deepkoco.fit.state.kalman import LinearModel
    from deepkoco.fit.state.kalman_node import AgedKalmanNode, KalmanNode

    by_node = {node: {k: float(v) for k, v in own.items()} for node, own in pool_parameters().items()}
    world, heater = by_node["world"], by_node["heater"]
    capacity = HEAT_CAPACITY * world["pool_volume"]
    loss, lag = world["heat_loss"] / capacity, 1.0 / heater["lag"]
    model = LinearModel(
        dynamics=[[-loss, 1.0 / capacity, 1.0 / capacity], [0.0, 0.0, 0.0], [0.0, 0.0, -lag]],
        command=[[0.0, loss], [0.0, 0.0], [lag * heater["scale"], 0.0]],
        sensor=[[1.0, 0.0, 0.0]],
        # The unknown heat wanders by some 2 kW in 5 minutes; the temperature hardly by itself.
        noise_density=[1e-8, options.heat_noise, 1e2],
        noise_sd=[0.05],
        longest_step=1.1 * STEP,
    )
    kind = AgedKalmanNode if options.filter == "flow" else KalmanNode
    return kind(
        "kalman",
        CONTROL_RATE,
        model,
        start=(29.0, 0.0, 0.0),
        start_sd=(3.0, 3e3, 1e3),
        age=options.constant_age + _sensor_age() if options.filter == "constant" else 0.0,
        longest_age=LONGEST_AGE,
        step=STEP,
        commanded=_heater_level_and_air,
        measured=_temperatures,
        phase=AFTER,
    )


def _sensor_age() -> float:
    """Age of what the thermometer shows beside the pipe: its lag, and half of a tick of the world."""
    return float(pool_parameters()["probe"]["lag"]) + 0.5 / WORLD_RATE


def _law(given: Any, usual: Any) -> Delay:
    return make_delay(usual if given is None else given)


# Functions of a module, so that nodes can be sent to processes of their own.


def _heater_level_and_air(commands: Tensor) -> Tensor:
    level = commands[..., :1].clamp(0.0, 1.0)
    air = float(pool_parameters()["world"]["air_temperature"])
    return torch.cat([level, torch.full_like(level, air)], -1)


def _temperatures(shown: dict[str, Tensor]) -> Tensor:
    return shown["temperature"][..., None]


def _temperature(shown: dict[str, Tensor]) -> Tensor:
    return shown["temperature"]


def _estimate(shown: dict[str, Tensor]) -> Tensor:
    return shown["state"][:, 0]
