"""The ODE engine: the system's own equations of motion, integrated in the graph; pure, any batch."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Self

import torch
from torch import Tensor

from deepkoco.engines.command_window import window_of_commands
from deepkoco.engines.hold import mean_over_tick
from deepkoco.engines.start import start_state
from deepkoco.graph import Delay, Input, Node
from deepkoco.graph.model.node import State
from deepkoco.systems import Parameters, System, rk4_step
from deepkoco.systems.plain import is_plain, needs_gradient
from deepkoco.systems.stick_slip import Joints, StickSlip


class World(Node):
    """The system's state, one tick of 1/rate [s] at a time; the output (B, S) is the state at the tick.

    Tick 0 puts out the start state; tick k integrates over (t_{k-1}, t_k]. The effort over a tick is the
    time average of the zero-order-hold commands received in it, so a delay may be finer than a tick and
    need not fit the ticks of anything. Commands are cut to the limits given here and to the system's.

    The start state is the parameter ``start`` (B, S), or what the runtime's reset gives as ``initial``.

    Under ``rk4`` dry friction is a constraint, as along a log: joints stick. Where gradients are wanted the sign of dry
    friction is smoothed instead, because a joint that sticks has none; ``semi_implicit_euler`` smooths it always.

    Args:
        system: Dynamics; a command of the graph is (..., M).
        rate: Ticks per second [Hz].
        integrator: ``rk4``, or ``semi_implicit_euler``, which at the control rate is Gymnasium's own scheme.
        command_limit: Largest command of all channels, or one for each, in the command's unit.
        speed_limit: The joints go no faster [rad/s]: without friction a random command would else spin one
            up without end, and Gymnasium's Pendulum-v1 has such a limit.
    """

    inputs = ("agent",)
    free_rate = True

    def __init__(
        self,
        system: System,
        rate: float,
        integrator: str = "rk4",
        command_limit: float | tuple[float, ...] = math.inf,
        speed_limit: float = math.inf,
    ) -> None:
        super().__init__("world", rate)
        self.entries: tuple[int, ...] | None = None
        """Which entries of a command are this object's; None: all."""
        self.period, self.speed_limit = 1.0 / rate, speed_limit
        self.system = system
        channels = system.commands
        if isinstance(command_limit, int | float):
            command_limit = (command_limit,) * len(channels)
        self.limits = tuple(
            (max(-limit, channel.low), min(limit, channel.high))
            for limit, channel in zip(command_limit, channels, strict=True)
        )
        self.advance_by = {"rk4": self._rk4, "semi_implicit_euler": self._semi_implicit_euler}[integrator]
        rubbing, remembering = StickSlip.sizes(system) if integrator == "rk4" else (0, 0)
        self.sticks, self.remembers = bool(rubbing or remembering), remembering

    def at_rate(self, rate: float | Fraction) -> Self:
        node = super().at_rate(rate)
        node.period, node.advance_by = float(1 / node.rate), getattr(node, self.advance_by.__name__)
        return node

    def least_window(self, delay: Delay, sender: Node) -> int:
        """Of commands, those of a tick and the one before them."""
        return window_of_commands(self, delay, sender)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        idle = torch.zeros(batch, len(self.limits), dtype=torch.float64)
        return {
            "state": start_state(self.system, parameters, batch),
            "effort": self.system.effort_of(idle),
            "started": torch.zeros(batch, dtype=torch.bool),
            **({"memory": torch.zeros(batch, self.remembers, dtype=torch.float64)} if self.remembers else {}),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["state"]

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        dt = self.period
        sent = inputs["agent"].data.to(torch.float64)
        if self.entries is not None:
            sent = torch.stack([sent[..., i] for i in self.entries], -1)
        cut = [sent[..., i].clamp(low, high) for i, (low, high) in enumerate(self.limits)]
        command = self.system.effort_of(torch.stack(cut, -1))
        target = self._delivered(self.system.actuate(command, parameters), inputs["agent"], parameters)
        lag = self.system.command_lags(parameters)
        # Exact first-order response; where the time constant is zero the effort is the target.
        held = torch.where(lag > 0, lag, 1.0)
        decay = torch.where(lag > 0, torch.exp(-dt / held), 0.0)
        mean = target + (state["effort"] - target) * torch.where(lag > 0, held / dt * (1.0 - decay), 0.0)
        started, carried = state["started"], {}
        if self.remembers:
            memory = state["memory"].unbind(-1)
            after, memory = self._stick_slip(state["state"], mean, dt, parameters, memory, started)
            carried["memory"] = torch.stack(memory, -1)
        else:
            after = self.advance_by(state["state"], mean, dt, parameters)
        now = torch.where(started[:, None], after, state["state"])
        if target.ndim > 1:
            started = started[:, None]
        delivered = torch.where(started, target + (state["effort"] - target) * decay, state["effort"])
        fixed = {"state": now, "effort": delivered, "started": torch.ones_like(state["started"])}
        return {**state, **fixed, **carried}, now

    def _delivered(self, efforts: Tensor, commands: Input, parameters: Parameters) -> Tensor:
        """Mean over the tick of what is held; a command with a delay of its own is held from later on."""
        further = self.system.further_delays(parameters)
        if further is None:
            return mean_over_tick(efforts, commands, self.period)
        means = []
        for index, delay in enumerate(further):
            late = commands.t_received + (delay.unsqueeze(-1) if delay.ndim else delay)
            means.append(mean_over_tick(efforts[..., index], commands._replace(t_received=late), self.period))
        return torch.stack(means, -1)

    def _stick_slip(
        self,
        state: Tensor,
        effort: Tensor,
        dt: float,
        parameters: Parameters,
        memory: tuple[Tensor, ...] = (),
        started: Tensor | None = None,
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """State after a tick in which joints can stick, and what effects remember then.

        The friction that held a joint before is not carried on, so the next state follows from the last one.
        """
        joints, batch = self.system.joints, state[..., 0]
        parts = state.unbind(-1)
        angles, speeds, further = parts[:joints], parts[joints : 2 * joints], state[..., 2 * joints :]
        efforts = (effort,) if len(self.limits) == 1 else effort.unbind(-1)
        law = StickSlip(self.system, parameters)
        rest = (torch.zeros_like(batch),) * len(law.rubbing)
        now = law.tick(Joints(angles, speeds, rest, memory), efforts, dt)
        remembered = now.memory
        if memory and started is not None and not (is_plain([batch]) and bool(started.all())):
            # The first tick only finds what effects remember at the start.
            first = law.first_memory(angles, speeds, efforts)
            pairs = zip(remembered, first, strict=True)
            remembered = tuple(torch.where(started, a, b + torch.zeros_like(batch)) for a, b in pairs)
        if further.shape[-1]:
            further = rk4_step(self.system, state, effort, dt, parameters)[..., 2 * joints :]
        after = self._joined(_stacked(now.angles, batch), _stacked(now.speeds, batch), further)
        return after, remembered

    def _rk4(self, state: Tensor, effort: Tensor, dt: float, parameters: Parameters) -> Tensor:
        if self.sticks and not needs_gradient([state, effort, *parameters.values()]):
            return self._stick_slip(state, effort, dt, parameters)[0]
        after = rk4_step(self.system, state, effort, dt, parameters)
        joints = self.system.joints
        if not math.isfinite(self.speed_limit):
            return after
        return self._joined(after[..., :joints], after[..., joints : 2 * joints], after[..., 2 * joints :])

    def _semi_implicit_euler(
        self, state: Tensor, effort: Tensor, dt: float, parameters: Parameters
    ) -> Tensor:
        joints = self.system.joints
        explicit = state + self.system.derivative(state, effort, parameters) * dt
        speed = self._limited(explicit[..., joints : 2 * joints])
        return self._joined(state[..., :joints] + speed * dt, speed, explicit[..., 2 * joints :])

    def _joined(self, angles: Tensor, speeds: Tensor, rest: Tensor) -> Tensor:
        parts = [angles, self._limited(speeds)]
        return torch.cat(parts if rest.shape[-1] == 0 else [*parts, rest], -1)

    def _limited(self, speed: Tensor) -> Tensor:
        return speed.clamp(-self.speed_limit, self.speed_limit) if math.isfinite(self.speed_limit) else speed


def _stacked(values: tuple[Tensor, ...], batch: Tensor) -> Tensor:
    """Values, each a scalar or (B,), as (B, K)."""
    return torch.stack([value + torch.zeros_like(batch) for value in values], -1)
