"""The MuJoCo engine's world: a node that holds a physics engine."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from deepkoco.engines.command_window import window_of_commands
from deepkoco.engines.engine import EngineError
from deepkoco.engines.hold import mean_over_tick
from deepkoco.engines.mjcf import HingedBody, model_xml
from deepkoco.engines.start import start_state
from deepkoco.extras import dependency_command
from deepkoco.graph import Delay, Input, Node
from deepkoco.graph.model.node import State
from deepkoco.systems import JointSystem, Parameters


class MujocoWorld(Node):
    """The state of a hinged body in MuJoCo, one tick at a time; the counterpart of the ODE engine's world.

    The same ticks, commands and limits; the motion is MuJoCo's. The model is made anew where an episode
    begins with other parameters. What the episode remembers is the node's state, so that a start state can be
    given and an episode repeated; the engine itself serves one environment.

    Args:
        system: Declares parameters, command and measurements.
        body: The body for given parameters.
        rate: Ticks per second [Hz].
        time_step: Longest step of the physics [s].
        command_limit: Largest command, in the command's unit.
        speed_limit: The joint goes no faster [rad/s].
    """

    inputs = ("agent",)
    pure = False

    def __init__(
        self,
        system: JointSystem,
        body: Callable[[Mapping[str, float]], HingedBody],
        rate: float,
        time_step: float = 1e-3,
        command_limit: float = math.inf,
        speed_limit: float = math.inf,
    ) -> None:
        super().__init__("world", rate)
        self.entries: tuple[int, ...] | None = None
        """Which entry of a command is this object's; None: the first."""
        self.system, self.body = system, body
        self.period, self.speed_limit = 1.0 / rate, speed_limit
        self.substeps = math.ceil(self.period / time_step - 1e-9)
        self.low = max(-command_limit, system.command.low)
        self.high = min(command_limit, system.command.high)
        self._simulator: _Simulator | None = None

    def least_window(self, delay: Delay, sender: Node) -> int:
        """Of commands, those of a tick and the one before them."""
        return window_of_commands(self, delay, sender)

    def close(self) -> None:
        self._simulator = None

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        if batch != 1:
            raise EngineError(f"mujoco: it runs 1 environment, not {batch}; use the ode engine")
        nominal = self.system.default_parameters()
        values = {name: float(torch.as_tensor(parameters.get(name, v))) for name, v in nominal.items()}
        if self._simulator is None or self._simulator.values != values:
            body = self.body(values)
            time_step = self.period / self.substeps
            xml = model_xml(self.system.name, body, self.system.command, self.system.measurements, time_step)
            self._simulator = _Simulator(values, xml)
        return {
            "state": start_state(self.system, parameters, batch),
            "started": torch.zeros(batch, dtype=torch.bool),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["state"]

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        assert self._simulator is not None
        command = (
            inputs["agent"].data[..., (self.entries or (0,))[0]].to(torch.float64).clamp(self.low, self.high)
        )
        effort = mean_over_tick(command, inputs["agent"], self.period)
        now = state["state"]
        if state["started"][0]:
            angle, speed = self._simulator.advance(now[0].tolist(), float(effort[0]), self.substeps)
            limit = self.speed_limit
            now = torch.tensor([[angle, min(max(speed, -limit), limit)]], dtype=torch.float64)
        return {"state": now, "started": torch.ones_like(state["started"])}, now


class _Simulator:
    """A compiled model and its data."""

    def __init__(self, values: dict[str, float], xml: str) -> None:
        self.values = values
        self._mujoco = import_mujoco()
        self.model = self._mujoco.MjModel.from_xml_string(xml)
        self.data = self._mujoco.MjData(self.model)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_mujoco": None}  # a module does not travel

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _mujoco=import_mujoco())

    def advance(self, state: list[float], effort: float, steps: int) -> tuple[float, float]:
        """Motion of (angle [rad], speed [rad/s]) under a constant effort.

        Raises:
            EngineError: The command or the state is no number any more.
        """
        if not math.isfinite(effort):
            raise EngineError(f"mujoco: command {effort} is not finite")
        data = self.data
        data.qpos[0], data.qvel[0] = state
        data.ctrl[0] = effort
        self._mujoco.mj_step(self.model, data, steps)
        if not (math.isfinite(data.qpos[0]) and math.isfinite(data.qvel[0])):
            raise EngineError("mujoco: the state is not finite any more; take a smaller time_step")
        return float(data.qpos[0]), float(data.qvel[0])


def import_mujoco() -> Any:
    """The module, imported by the first who needs it.

    Raises:
        EngineError: It is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise EngineError(f"the mujoco engine needs MuJoCo: {dependency_command('mujoco')}") from error
    return mujoco
