"""The unit engine: the object is a machine in a process of its own, reached by commands and measurements."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from deepkoco.engines.command_window import window_of_commands
from deepkoco.engines.engine import Engine, EngineError
from deepkoco.engines.reset import ResetNode, Teleport
from deepkoco.engines.start import start_state
from deepkoco.graph import Delay, Input, Node
from deepkoco.graph.model.node import State
from deepkoco.systems import JointSystem, Parameters, System
from deepkoco.unit import SensorMessage, SimulatedUnit, Unit, UnitSpec, load_unit, make_unit

CLOCKS = {"wall": Unit, "simulated": SimulatedUnit}


@dataclass(frozen=True)
class UnitEngine(Engine):
    """A unit: real time and the ``wall-clock`` runtime, or virtual time and the ``simulated`` one.

    Attributes:
        unit: Path of a UNIT.yaml or a spec; None: a unit of the object without hidden effects.
        clock: ``wall``: the unit's own process; ``simulated``: the same machine in virtual time.
        reset: Brings it to the start state between episodes.
    """

    unit: str | Path | UnitSpec | None = None
    clock: str = "wall"
    reset: ResetNode = field(default_factory=Teleport)
    name: ClassVar[str] = "unit"

    def __post_init__(self) -> None:
        if self.clock not in CLOCKS:
            raise EngineError(f'clock "{self.clock}" is none of {", ".join(CLOCKS)}')

    @property
    def real_time(self) -> bool:  # type: ignore[override]
        return self.clock == "wall"

    def nodes(self, system: System) -> tuple[Node, Node]:
        if not isinstance(system, JointSystem):
            raise EngineError(
                f"unit: there is no unit of {system.name}; units have one joint and one command"
            )
        if self.unit is None:
            spec = make_unit(system.name)
        else:
            spec = self.unit if isinstance(self.unit, UnitSpec) else load_unit(self.unit)
        if spec.system != system.name:
            raise EngineError(f'unit "{spec.name}" is a {spec.system}, the object a {system.name}')
        world = UnitWorld(spec, system, self.world_rate, self.clock, self.reset, self.command_limit)
        return world, Relay(system, self.sensor_rate or self.world_rate)


class UnitWorld(Node):
    """The unit's end of the line: hands on the newest command and puts out the last measurement (1, N).

    It opens and closes the unit; closed, the unit's command is zero. Between episodes its reset node brings the
    unit to the parameter ``start``.

    Args:
        spec: The unit.
        system: Declares command and measurements.
        rate: Ticks per second [Hz].
        clock: ``wall`` or ``simulated``.
        reset: Brings the unit to the start state.
        command_limit: Largest command, in the command's unit.
    """

    inputs = ("agent",)
    pure = False
    free_rate = True

    def __init__(
        self,
        spec: UnitSpec,
        system: JointSystem,
        rate: float,
        clock: str,
        reset: ResetNode,
        command_limit: float,
    ) -> None:
        super().__init__("world", rate)
        self.entries: tuple[int, ...] | None = None
        """Which entry of a command is this object's; None: the first."""
        self.spec, self.system, self.clock, self.reset = spec, system, clock, reset
        self.low = max(-command_limit, system.command.low)
        self.high = min(command_limit, system.command.high)
        self._unit: Unit | SimulatedUnit | None = None
        self._origin = 0.0

    def least_window(self, delay: Delay, sender: Node) -> int:
        """Of commands, those of a tick and the one before them."""
        return window_of_commands(self, delay, sender)

    def open(self) -> None:
        self._unit = CLOCKS[self.clock](self.spec).__enter__()

    def rest(self) -> None:
        self._running.send(0.0)

    def close(self) -> None:
        unit, self._unit = self._unit, None
        if unit is not None:
            unit.close()

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        if batch != 1:
            raise EngineError(f"unit: it is one machine, not {batch}")
        if isinstance(self._unit, SimulatedUnit):
            self._unit.seed_noise(int(torch.randint(2**62, (), generator=generator)))
        angle, speed = start_state(self.system, parameters, 1)[0].tolist()
        message = self.reset.run(self._running, (angle, speed))
        self._origin = self._running.now()
        return {"measured": _values(message)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["measured"]

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        unit, measured = self._running, state["measured"]
        # In virtual time the unit moves on while it is waited for; in real time it has.
        due = self._origin + float(inputs["agent"].t_start[0]) if self.clock == "simulated" else 0.0
        while (message := unit.poll(max(0.0, due - unit.now()))) is not None:
            measured = _values(message)
        command = float(inputs["agent"].data[0, -1, (self.entries or (0,))[0]])
        unit.send(min(max(command, self.low), self.high))
        return {"measured": measured}, measured

    @property
    def _running(self) -> Unit | SimulatedUnit:
        if self._unit is None:
            raise EngineError(
                f'unit "{self.spec.name}" is not open: run it in a runtime that opens its nodes'
            )
        return self._unit


class Relay(Node):
    """Hands on the world's last output: the unit has measured already."""

    inputs = ("world",)
    free_rate = True

    def __init__(self, system: JointSystem, rate: float) -> None:
        super().__init__("sensor", rate)
        self.system = system

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"last": start_state(self.system, parameters, batch)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["last"]

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        last = inputs["world"].data[:, -1]
        return {"last": last}, last


def _values(message: SensorMessage) -> Tensor:
    return torch.tensor([message.values], dtype=torch.float64)
