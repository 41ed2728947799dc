"""The nodes of a one-joint robot: world, sensor, and the agent, which is the graph's supervisor."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from deepkoco.envs.noise import draw_keys, normal
from deepkoco.envs.tasks import SwingUp
from deepkoco.graph import Input, Node, Supervisor
from deepkoco.graph.node import State
from deepkoco.systems import JointSystem, Parameters, rk4_step


class World(Node):
    """The system's state, one tick of 1/rate [s] at a time; the output (B, S) is the state at the tick.

    Tick 0 puts out the start state; tick k integrates over (t_{k-1}, t_k]. The effort over a tick is the
    time average of the zero-order-hold commands received in it, so a delay may be finer than a tick and
    need not fit the ticks of anything. Commands are cut to the limits of the task and of the system.

    The start state comes from the environment, through ``initial`` of the runtime's reset.

    The joint goes no faster than the task's speed limit, as in Gymnasium's Pendulum-v1: without friction a
    random command would else spin it up without end.

    Args:
        system: Dynamics.
        task: Says the limits of command and speed.
        rate: Ticks per second [Hz].
        integrator: ``rk4``, or ``semi_implicit_euler``, which at the control rate is Gymnasium's own scheme.
    """

    def __init__(self, system: JointSystem, task: SwingUp, rate: float, integrator: str) -> None:
        super().__init__("world", rate)
        self.period = 1.0 / rate
        self.system, self.task = system, task
        self.low = max(-task.command_limit, system.command.low)
        self.high = min(task.command_limit, system.command.high)
        self.advance_by = {"rk4": self._rk4, "semi_implicit_euler": self._semi_implicit_euler}[integrator]

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {
            "state": torch.zeros(batch, len(self.system.state_names), dtype=torch.float64),
            "effort": torch.zeros(batch, dtype=torch.float64),
            "started": torch.zeros(batch, dtype=torch.bool),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["state"]

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        commands = inputs["agent"]
        dt, end = self.period, commands.t_start
        # Each command holds from its arrival to the next one's; the oldest has held since before the tick.
        arrival = torch.minimum(torch.maximum(commands.t_received, (end - dt)[:, None]), end[:, None])
        until = torch.cat([arrival[:, 1:], end[:, None]], 1)
        since = torch.cat([(end - dt)[:, None], arrival[:, 1:]], 1)
        command = commands.data[..., 0].to(torch.float64).clamp(self.low, self.high)
        effort = self.system.actuate(command, parameters)
        target = (effort * (until - since)).sum(1) / dt
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
        limit = self.task.speed_limit
        return torch.stack([after[..., 0], after[..., 1].clamp(-limit, limit)], -1)

    def _semi_implicit_euler(
        self, state: Tensor, effort: Tensor, dt: float, parameters: Parameters
    ) -> Tensor:
        slope = self.system.derivative(state, effort, parameters)
        limit = self.task.speed_limit
        speed = (state[..., 1] + slope[..., 1] * dt).clamp(-limit, limit)
        return torch.stack([state[..., 0] + speed * dt, speed], -1)


class Sensor(Node):
    """Measures the world's last state; the output is (B, N).

    Before the first message has come a receiver sees a measurement of the start state ``start`` (B, S),
    which the environment gives through ``initial`` of the runtime's reset.

    Args:
        system: Declares the measurements.
        rate: Measurements per second [Hz].
        noise: Standard deviation of the noise per channel, in the channel's unit.
    """

    def __init__(self, system: JointSystem, rate: float, noise: tuple[float, ...]) -> None:
        super().__init__("sensor", rate)
        self.system, self.noise = system, noise
        self.noisy = any(spread > 0.0 for spread in noise)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        state = {"start": torch.zeros(batch, len(self.system.state_names), dtype=torch.float64)}
        if self.noisy:
            state["key"] = draw_keys(batch, generator)
            state["tick"] = torch.zeros(batch, dtype=torch.int64)
        return state

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        clean = self.system.measure(state["start"], parameters)
        return clean + self._draw(state) if self.noisy else clean

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        clean = self.system.measure(inputs["world"].data[:, -1], parameters)
        if not self.noisy:
            return state, clean
        return {**state, "tick": state["tick"] + 1}, clean + self._draw(state)

    def _draw(self, state: State) -> Tensor:
        """Noise of this tick (B, N)."""
        draws = [
            spread * normal(state["key"], state["tick"], channel) for channel, spread in enumerate(self.noise)
        ]
        return torch.stack(draws, -1)


class SwingUpAgent(Supervisor):
    """The seat of the agent: it sees measurements, and is paid for the true state and its command.

    Readings: ``observation`` (B, N) of what it has received, then its last commands, newest first;
    ``reward`` (B,), minus the task's cost of the true state at its step before and the command given then;
    ``angle_from_upright`` (B,) [rad] of the true state now.

    Args:
        system: Declares the measurements.
        task: Says what the agent sees and pays, and its rate.
        history: How many commands are appended.
        scale: Commands are divided by it before they are appended, in the command's unit.
    """

    inputs = ("truth", "sensor")

    def __init__(self, system: JointSystem, task: SwingUp, history: int = 0, scale: float = 1.0) -> None:
        super().__init__(rate=task.control_rate, initial_action=torch.zeros(1, dtype=torch.float64))
        self.system, self.task, self.history, self.scale = system, task, history, scale

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        state = {
            "truth": torch.zeros(batch, len(self.system.state_names), dtype=torch.float64),
            "command": torch.zeros(batch, dtype=torch.float64),
        }
        if self.history:
            state["history"] = torch.zeros(batch, self.history, dtype=torch.float64)
        return state

    def observe(
        self, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: Tensor
    ) -> tuple[State, dict[str, Tensor]]:
        truth = inputs["truth"].data[:, -1]
        observation = self.task.observation(self.system, inputs["sensor"].data[:, -1])
        reward = -self.task.cost(self.system, state["truth"], action[:, 0])
        state = {**state, "truth": truth, "command": action[:, 0]}
        if self.history:
            state["history"] = torch.cat([action / self.scale, state["history"][:, :-1]], 1)
            observation = torch.cat([observation, state["history"]], 1)
        angle = self.task.angle_from_upright(self.system, truth)
        return state, {"observation": observation, "reward": reward, "angle_from_upright": angle}
