"""The ODE engine: the system's own equations of motion, integrated in the graph; pure, any batch."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepkoco.engines.hold import mean_over_tick
from deepkoco.engines.start import start_state
from deepkoco.graph import Input, Node
from deepkoco.graph.node import State
from deepkoco.systems import JointSystem, Parameters, rk4_step


class World(Node):
    """The system's state, one tick of 1/rate [s] at a time; the output (B, S) is the state at the tick.

    Tick 0 puts out the start state; tick k integrates over (t_{k-1}, t_k]. The effort over a tick is the
    time average of the zero-order-hold commands received in it, so a delay may be finer than a tick and
    need not fit the ticks of anything. Commands are cut to the limits given here and to the system's.

    The start state is the parameter ``start`` (B, S), or what the runtime's reset gives as ``initial``.

    Args:
        system: Dynamics.
        rate: Ticks per second [Hz].
        integrator: ``rk4``, or ``semi_implicit_euler``, which at the control rate is Gymnasium's own scheme.
        command_limit: Largest command, in the command's unit.
        speed_limit: The joint goes no faster [rad/s]: without friction a random command would else spin it
            up without end, and Gymnasium's Pendulum-v1 has such a limit.
    """

    inputs = ("agent",)

    def __init__(
        self,
        system: JointSystem,
        rate: float,
        integrator: str = "rk4",
        command_limit: float = math.inf,
        speed_limit: float = math.inf,
    ) -> None:
        super().__init__("world", rate)
        self.period, self.speed_limit = 1.0 / rate, speed_limit
        self.system = system
        self.low = max(-command_limit, system.command.low)
        self.high = min(command_limit, system.command.high)
        self.advance_by = {"rk4": self._rk4, "semi_implicit_euler": self._semi_implicit_euler}[integrator]

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {
            "state": start_state(self.system, parameters, batch),
            "effort": torch.zeros(batch, dtype=torch.float64),
            "started": torch.zeros(batch, dtype=torch.bool),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["state"]

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        dt = self.period
        command = inputs["agent"].data[..., 0].to(torch.float64).clamp(self.low, self.high)
        target = mean_over_tick(self.system.actuate(command, parameters), inputs["agent"], dt)
        lag = self.system.timing(parameters).lag
        # Exact first-order response; where the time constant is zero the effort is the target.
        held = torch.where(lag > 0, lag, 1.0)
        decay = torch.where(lag > 0, torch.exp(-dt / held), 0.0)
        mean = target + (state["effort"] - target) * torch.where(lag > 0, held / dt * (1.0 - decay), 0.0)
        after = self.advance_by(state["state"], mean, dt, parameters)
        started = state["started"]
        now = torch.where(started[:, None], after, state["state"])
        delivered = torch.where(started, target + (state["effort"] - target) * decay, state["effort"])
        return {"state": now, "effort": delivered, "started": torch.ones_like(started)}, now

    def _rk4(self, state: Tensor, effort: Tensor, dt: float, parameters: Parameters) -> Tensor:
        after = rk4_step(self.system, state, effort, dt, parameters)
        return torch.stack([after[..., 0], self._limited(after[..., 1])], -1)

    def _semi_implicit_euler(
        self, state: Tensor, effort: Tensor, dt: float, parameters: Parameters
    ) -> Tensor:
        slope = self.system.derivative(state, effort, parameters)
        speed = self._limited(state[..., 1] + slope[..., 1] * dt)
        return torch.stack([state[..., 0] + speed * dt, speed], -1)

    def _limited(self, speed: Tensor) -> Tensor:
        return speed.clamp(-self.speed_limit, self.speed_limit) if math.isfinite(self.speed_limit) else speed
