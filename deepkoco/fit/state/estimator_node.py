"""The state estimator as a node of a graph: an unscented filter that predicts to the time at which commands act."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import torch
from torch import Tensor

from deepkoco.engines.hold import held_integral
from deepkoco.fit.state.lags import LagStates
from deepkoco.fit.state.triangular import lower_root
from deepkoco.fit.state.unscented import Belief, FilterError, SigmaPoints, predict, update
from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import State
from deepkoco.systems import Parameters, System, rk4_step

LONGEST_STEP = 0.01  # longest integration step at the usual distances of measurements [s]


class StateEstimator(Node):
    """Estimates the state from measurements that come late, and predicts it to when the next command will act.

    It stands between a sensor and an agent. At each tick it takes in the measurements that have arrived since the last
    one, each at the time of its stamp, and then goes on to ``ahead`` after the tick under the commands that were sent.
    The mean command over each step of the integration is held, so a command may act at any instant. The efforts of E
    actuators with a time constant are states of their own behind the system's (`LagStates`), and commands may have
    delays of their own beyond the common one.

    Inputs: ``sensor``, a window of measurements (N), and ``agent``, a window of commands (M) that skips. A window of
    commands has to reach back to the oldest measurement: `commands_needed`. Of the measurements that come between two
    ticks, those beyond the window are not used.

    Output, in parts: ``measurement`` (B, N), what sensors without noise and delay would show at the time of the
    estimate; ``state`` (B, S), the estimate; ``root`` (B, S + E, S + E), lower triangular, a root of the covariance;
    and where there are any, ``effort`` (B, E), what the actuators with a time constant deliver. `TaskAgent` takes the
    measurement in the place of a sensor's.

    All steps are fixed in number, so it runs in each executor and runtime. For recordings, with measurements that come
    out of order, `DelayedEstimator` does the same without that limit.

    Args:
        system: The model; its parameters are those of this node, or the nominal ones where it is given none.
        rate: Ticks per second, those of the agent [Hz].
        noise_density: (S + E,) spectral density of the process noise of each state, its unit squared per second.
        noise_sd: (N,) standard deviation of each sensor, above 0.
        ahead: How long after a tick the estimate is for [s]; None: the time of the newest measurement (filtered only).
        actuation_delay: Expected time from the sending of a command until it acts, tau_a [s].
        sensing_delay: Time from a state until its measurement gets its stamp, tau_s [s].
        measurement_period: Usual time between two measurements [s].
        latest: Longest usual age of the newest measurement [s]. It sets the number of steps of the prediction; a longer
            one is made in longer steps.
        start_sd: (S + E,) standard deviation before the first measurement: around zero, of the efforts around what is
            held then.
        command_limits: (low, high) of each command, to which it is cut; None takes those of the channels.
        idle: Commands (M,) that are held before the first one is sent; None: zeros.
        points: Parameters of the sigma points.
        longest_step: Longest integration step at the usual distances [s].
        **options: As for `Node`.

    Raises:
        FilterError: A size does not fit the system, or a standard deviation is not above 0.

    Source: thesis alg. 6; van der Merwe, Wan, The square-root unscented Kalman filter (2001).
    """

    inputs = ("sensor", "agent")

    def __init__(
        self,
        system: System,
        rate: float | Fraction,
        noise_density: tuple[float, ...],
        noise_sd: tuple[float, ...],
        *,
        ahead: float | None,
        actuation_delay: float = 0.0,
        sensing_delay: float = 0.0,
        measurement_period: float,
        latest: float,
        start_sd: tuple[float, ...],
        command_limits: tuple[tuple[float, float], ...] | None = None,
        idle: tuple[float, ...] | None = None,
        points: SigmaPoints | None = None,
        longest_step: float = LONGEST_STEP,
        name: str = "estimator",
        **options: Any,
    ) -> None:
        super().__init__(name, rate, **options)
        self.lags = LagStates(system)
        self._check(system, noise_density, noise_sd, start_sd)
        width, channels = self.lags.width, system.measurements
        self.outputs = {
            "measurement": ((len(channels),), torch.float64),
            "state": ((self.lags.states,), torch.float64),
            "root": ((width, width), torch.float64),
        }
        if self.lags.commands:
            self.outputs["effort"] = ((len(self.lags.commands),), torch.float64)
        self._idle = torch.tensor(idle or (0.0,) * len(system.commands), dtype=torch.float64)
        further = system.further_delays(system.default_parameters()) or ()
        self._latest_command = max((float(delay) for delay in further), default=0.0)
        self.system, self.ahead = system, ahead
        self.actuation_delay, self.sensing_delay = actuation_delay, sensing_delay
        self.limits = command_limits or tuple((c.low, c.high) for c in system.commands)
        self.points = SigmaPoints() if points is None else points
        self._density = torch.tensor(noise_density, dtype=torch.float64).sqrt()
        self._noise = torch.tensor(noise_sd, dtype=torch.float64)
        self._angle = torch.tensor([c.angle for c in channels])
        self._start = torch.diag(torch.tensor(start_sd, dtype=torch.float64))
        self._between = _steps(measurement_period, longest_step)
        self._ahead_steps = 0 if ahead is None else _steps(latest + ahead, longest_step)

    def commands_needed(self, latest: float, rate: float) -> int:
        """Window of the connection from the agent.

        Args:
            latest: Longest age of the oldest measurement of a tick [s].
            rate: Commands per second [Hz].
        """
        return 2 + math.ceil((latest + self.actuation_delay + self._latest_command) * rate)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        width = len(self._start)
        mean = torch.zeros(batch, width, dtype=torch.float64)
        if self.lags.commands:
            known = parameters or self.system.default_parameters()
            held = self.system.actuate(self.system.effort_of(self._idle.expand(batch, -1)), known)
            mean[:, self.lags.states :] = self.lags.efforts(held)
        return {
            "mean": mean,
            "root": self._start.expand(batch, width, width).clone(),
            "since": torch.zeros(batch, dtype=torch.float64),
            # What the sensor showed before its first message, with the number -1, is a measurement of the start.
            "seen": torch.full((batch,), -2, dtype=torch.int64),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> dict[str, Tensor]:
        return self._output(Belief(state["mean"], state["root"]))

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input]
    ) -> tuple[State, dict[str, Tensor]]:
        model = _by_point(parameters or self.system.default_parameters())
        sensor, agent = inputs["sensor"], inputs["agent"]
        sent = agent.data.to(torch.float64)
        cut = [sent[..., i].clamp(low, high) for i, (low, high) in enumerate(self.limits)]
        held = self.system.actuate(self.system.effort_of(torch.stack(cut, -1)), model)
        acts = agent.t_sent + self.actuation_delay
        belief, since, seen = Belief(state["mean"], state["root"]), state["since"], state["seen"]
        noise, angle = self._noise.to(since.device), self._angle.to(since.device)
        for k in range(sensor.seq.shape[1]):
            seq = sensor.seq[:, k]
            new = seq > seen
            taken = torch.where(seq < 0, since, sensor.t_sent[:, k] - self.sensing_delay)
            taken = torch.where(new, torch.maximum(taken, since), since)
            moved = self._carry(belief, since, taken, held, acts, model, self._between)
            shown, _ = update(moved, self._measure, sensor.data[:, k], noise, self.points, angle)
            belief, since, seen = shown.where(new, belief), taken, torch.maximum(seq, seen)
        after = {"mean": belief.mean, "root": belief.root, "since": since, "seen": seen}
        if self.ahead is not None:
            until = torch.maximum(agent.t_start + self.ahead, since)
            belief = self._carry(belief, since, until, held, acts, model, self._ahead_steps)
        return after, self._output(belief)

    def _carry(
        self,
        belief: Belief,
        start: Tensor,
        stop: Tensor,
        held: Tensor,
        acts: Tensor,
        model: Parameters,
        count: int,
    ) -> Belief:
        """The belief at ``stop`` (B,), in ``count`` steps from ``start`` (B,) [s], under the commands held between."""
        length = stop - start
        h = length / count
        safe = torch.where(h > 0, h, 1.0)
        targets = [self._held(held, acts, start + i * h, h, safe, model) for i in range(count)]

        def move(points: Tensor) -> Tensor:
            for target in targets:
                # The same for all sigma points of an environment.
                shared = target[:, None].expand(*points.shape[:2], *target.shape[1:])
                if not self.lags.commands:
                    points = rk4_step(self.system, points, shared, h[:, None], model)
                    continue
                mean, ends = self.lags.after(points, shared, h[:, None], model)
                state = rk4_step(self.system, self.lags.plain(points), mean, h[:, None], model)
                points = torch.cat([state, *(end[..., None] for end in ends)], -1)
            return points

        # Half of the noise before and half after: to first order that is noise at all times in between.
        half = torch.diag_embed(self._density.to(length.device)) * (0.5 * length).sqrt()[:, None, None]
        before = Belief(belief.mean, lower_root(torch.cat([belief.root.mT, half], 1)))
        return predict(before, move, half, self.points)

    def _held(
        self, held: Tensor, acts: Tensor, begin: Tensor, h: Tensor, safe: Tensor, model: Parameters
    ) -> Tensor:
        """Mean of what is held over a step from ``begin`` (B,): (B, M), or (B,) of a single command."""
        further = self.system.further_delays(model)
        if further is None:
            mean = held_integral(held, acts, begin, begin + h)
            return mean / (safe if mean.ndim == 1 else safe[:, None])
        means = [held_integral(held[..., k], acts + d, begin, begin + h) for k, d in enumerate(further)]
        return torch.stack([mean / safe for mean in means], -1)

    def _measure(self, points: Tensor) -> Tensor:
        return self.system.ideal_measurement(self.lags.plain(points))

    def _output(self, belief: Belief) -> dict[str, Tensor]:
        output = {
            "measurement": self._measure(belief.mean),
            "state": self.lags.plain(belief.mean),
            "root": belief.root,
        }
        if self.lags.commands:
            output["effort"] = belief.mean[:, self.lags.states :]
        return output

    def _check(
        self,
        system: System,
        density: tuple[float, ...],
        noise_sd: tuple[float, ...],
        start_sd: tuple[float, ...],
    ) -> None:
        states, channels = self.lags.width, len(system.measurements)
        for what, values, count, least in (
            ("noise_density", density, states, 0.0),
            ("noise_sd", noise_sd, channels, None),
            ("start_sd", start_sd, states, None),
        ):
            if len(values) != count:
                raise FilterError(f"{what} has {len(values)} values; {system.name} has {count}")
            if not all(v > 0.0 if least is None else v >= least for v in values):
                raise FilterError(
                    f"{what} = {values}; give {'values above 0' if least is None else '0 or more'}"
                )


def _steps(length: float, longest: float) -> int:
    return max(math.ceil(length / longest - 1e-9), 1)


def _by_point(parameters: Parameters) -> Parameters:
    """Parameters, scalars or (B,), against states (B, K) of sigma points."""
    return {name: value if value.ndim == 0 else value[:, None] for name, value in parameters.items()}
