"""Estimate the present state from delayed measurements: filter in the past, then predict with the commands."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from deepkoco.fit.state.lags import LagStates
from deepkoco.fit.state.unscented import Belief, FilterError, SigmaPoints, predict, update
from deepkoco.systems import Parameters, System

LONGEST_STEP = 0.01  # longest integration step [s]
Derivative = Callable[[Tensor, Tensor], Tensor]  # states (B, K, S), commands (B, 1, M) -> (B, K, S)
Density = Tensor | Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Memory:
    """Measurements, beliefs and commands that an estimator keeps for B environments. It is immutable.

    Attributes:
        time: (B, K) times at which the kept measurements were taken [s], ascending; -inf in unused places.
        value: (B, K, N) measurements, NaN where a channel was missing.
        noise_sd: (B, K, N) standard deviations of their noise.
        mean: (B, K, S) means of the beliefs after each measurement.
        root: (B, K, S, S) roots of their covariances.
        before: Belief before the oldest kept measurement.
        since: (B,) time of ``before`` [s].
        acts: (B, C) times from which the kept commands act [s], ascending; -inf in unused places.
        command: (B, C, M) commands, each held until the next.
        dropped: (B,) number of measurements that were older than ``since`` and not used.
    """

    time: Tensor
    value: Tensor
    noise_sd: Tensor
    mean: Tensor
    root: Tensor
    before: Belief
    since: Tensor
    acts: Tensor
    command: Tensor
    dropped: Tensor

    def newest(self) -> tuple[Belief, Tensor]:
        """Belief after the newest measurement, and the time (B,) of that measurement [s]."""
        there = torch.isfinite(self.time[:, -1])
        last = Belief(self.mean[:, -1], self.root[:, -1]).where(there, self.before)
        return last, torch.where(there, self.time[:, -1], self.since)

    def where(self, mask: Tensor, other: Memory) -> Memory:
        """Combine two memories of the same sizes: this one where the mask (B,) is true, ``other`` in the rest."""

        def combined(own: Tensor, others: Tensor) -> Tensor:
            return torch.where(mask.reshape(-1, *(1,) * (own.ndim - 1)), own, others)

        joined: dict[str, Any] = {
            f.name: combined(getattr(self, f.name), getattr(other, f.name))
            for f in fields(self)
            if f.name != "before"
        }
        return Memory(**joined, before=self.before.where(mask, other.before))


class DelayedEstimator:
    """Unscented filter with forward prediction, for B environments at once.

    A measurement with time stamp t shows the state at t - tau_s. A command that is sent at t acts from t + tau_a. The
    filter processes each measurement at the time at which it was taken. Measurements can be out of order, irregular or
    incomplete, and each can have its own noise. `estimate` then predicts the belief to the time at which the next
    command will act, under the commands that act until then.

    Args:
        derivative: Equations of motion: states (B, K, S), commands (B, 1, M) -> (B, K, S).
        measure: States (B, K, S) -> measurements (B, K, N).
        noise_density: Spectral density of the process noise, (S, S) or (B, S, S), units of the state squared per
            second; or a function that computes it for times (B,) [s].
        noise_sd: (N,) standard deviation of each sensor; `receive` can replace it.
        kept: Number of measurements that are kept. A measurement that is older than these is not used.
        points: Parameters of the sigma points.
        angle: (N,) True for channels that are wrapped angles [rad].
        longest_step: Longest integration step [s].
        further: (M,) how much longer than tau_a each command takes until it acts [s]; None: all act at the same time.

    Raises:
        FilterError: A density is not symmetric and positive semidefinite, or ``kept`` is below 1.

    Source: thesis alg. 6; Julier, Uhlmann, Unscented filtering and nonlinear estimation (2004).
    """

    def __init__(
        self,
        derivative: Derivative,
        measure: Callable[[Tensor], Tensor],
        noise_density: Density,
        noise_sd: Tensor,
        *,
        kept: int = 16,
        points: SigmaPoints | None = None,
        angle: Tensor | None = None,
        longest_step: float = LONGEST_STEP,
        further: Tensor | None = None,
    ) -> None:
        if kept < 1:
            raise FilterError(f"kept: {kept}; an estimator must keep at least one measurement")
        self.derivative, self.measure, self.noise_sd = derivative, measure, noise_sd
        self.density = noise_density
        self._constant = None if callable(noise_density) else _root_of(noise_density)
        self.kept, self.angle, self.longest_step = kept, angle, longest_step
        self.points = SigmaPoints() if points is None else points
        self.further = further

    def start(self, belief: Belief, since: Tensor, command: Tensor, commands: int = 64) -> Memory:
        """Memory before the first measurement.

        Args:
            belief: Belief over the states at ``since``.
            since: (B,) start time [s].
            command: (B, M) command that acts before the first one that is sent.
            commands: Number of commands that are kept, at least those that act after the oldest kept measurement.
        """
        count, kept = len(since), self.kept
        channels = (count, kept, len(self.noise_sd))
        empty = torch.full((count, kept), -math.inf, dtype=torch.float64)
        return Memory(
            empty,
            torch.full(channels, math.nan, dtype=torch.float64),
            torch.ones(channels, dtype=torch.float64),
            belief.mean[:, None].expand(-1, kept, -1),
            belief.root[:, None].expand(-1, kept, -1, -1),
            belief,
            since,
            torch.full((count, commands), -math.inf, dtype=torch.float64),
            command[:, None].expand(-1, commands, -1),
            torch.zeros(count, dtype=torch.int64),
        )

    def send(self, memory: Memory, time: Tensor, command: Tensor, actuation_delay: Tensor | float) -> Memory:
        """Add commands to the memory.

        Args:
            memory: Memory before.
            time: (B,) times at which they are sent [s].
            command: (B, M) commands.
            actuation_delay: tau_a of these commands [s], scalar or (B,). A command never acts before an earlier one.
        """
        acts = torch.maximum(time + actuation_delay, memory.acts[:, -1])
        return replace(
            memory,
            acts=torch.cat([memory.acts[:, 1:], acts[:, None]], 1),
            command=torch.cat([memory.command[:, 1:], command[:, None]], 1),
        )

    def receive(
        self,
        memory: Memory,
        time: Tensor,
        value: Tensor,
        sensing_delay: Tensor | float,
        noise_sd: Tensor | None = None,
    ) -> Memory:
        """Add measurements to the memory, each at the time at which it was taken.

        Args:
            memory: Memory before.
            time: (B,) time stamps [s]; NaN for an environment without a new measurement.
            value: (B, N) measurements; NaN where a channel is missing.
            sensing_delay: tau_s of these measurements [s], scalar or (B,).
            noise_sd: Standard deviations of their noise, (N,) or (B, N); None takes the estimator's.
        """
        taken = time - sensing_delay
        new = torch.isfinite(taken) & (taken >= memory.since)
        dropped = memory.dropped + (torch.isfinite(taken) & ~new)
        noise = (self.noise_sd if noise_sd is None else noise_sd).expand_as(value)
        # An environment without a new measurement gets an unused place. It sorts to the front and is removed.
        times = torch.cat([memory.time, torch.where(new, taken, -math.inf)[:, None]], 1)
        order = torch.argsort(times, dim=1, stable=True)
        times = times.gather(1, order)
        columns = order[..., None].expand(-1, -1, value.shape[1])
        values = torch.cat([memory.value, value[:, None]], 1).gather(1, columns)
        noises = torch.cat([memory.noise_sd, noise[:, None]], 1).gather(1, columns)
        # There is one place too many: the oldest measurement becomes a part of the belief `before`.
        size = memory.mean.shape[2]
        means = torch.cat([memory.mean, memory.mean[:, -1:]], 1).gather(
            1, order[..., None].expand(-1, -1, size)
        )
        roots = torch.cat([memory.root, memory.root[:, -1:]], 1)
        roots = roots.gather(1, order[..., None, None].expand(-1, -1, size, size))
        # Beliefs at and after the new measurement are computed again.
        stale = torch.cumsum(order == self.kept, 1).bool() & new[:, None]
        belief, at = memory.before, memory.since
        beliefs = []
        for k in range(self.kept + 1):
            again, there = stale[:, k], torch.isfinite(times[:, k])
            kept = Belief(means[:, k], roots[:, k])
            if bool(again.any()):
                moved = self._predict_until(memory, belief, at, torch.where(again, times[:, k], at))
                stepped, _ = update(moved, self.measure, values[:, k], noises[:, k], self.points, self.angle)
                kept = stepped.where(again, kept)
            belief = kept.where(there, belief)
            at = torch.where(there, times[:, k], at)
            beliefs.append(belief)
            if k == 0:
                before, since = belief, at
        return replace(
            memory,
            time=times[:, 1:],
            value=values[:, 1:],
            noise_sd=noises[:, 1:],
            mean=torch.stack([b.mean for b in beliefs[1:]], 1),
            root=torch.stack([b.root for b in beliefs[1:]], 1),
            before=before,
            since=since,
            dropped=dropped,
        )

    def estimate(self, memory: Memory, time: Tensor, actuation_delay: Tensor | float = 0.0) -> Belief:
        """Predict the belief over the states at ``time`` + tau_a, when a command that is sent now will act.

        Args:
            memory: Memory at this time.
            time: (B,) present time [s].
            actuation_delay: tau_a [s], scalar or (B,); 0 for the state now.
        """
        belief, at = memory.newest()
        return self._predict_until(memory, belief, at, torch.maximum(time + actuation_delay, at))

    def _predict_until(self, memory: Memory, belief: Belief, start: Tensor, stop: Tensor) -> Belief:
        """Predict a belief from ``start`` to ``stop`` (B,) [s], in one piece per command that acts in between."""
        changes = memory.acts
        if self.further is not None:
            changes = (memory.acts[..., None] + self.further).flatten(1).sort(1).values
        edges = torch.cat([start[:, None], changes, stop[:, None]], 1)
        edges = torch.minimum(torch.maximum(edges, start[:, None]), stop[:, None])
        length = edges.diff(dim=1)  # (B, C + 1)
        for c in torch.nonzero((length > 0).any(0))[:, 0].tolist():
            command = self._held(memory, c, edges[:, c])
            count = max(math.ceil(float(length[:, c].max()) / self.longest_step - 1e-9), 1)
            step = length[:, c] / count
            for i in range(count):
                root = self._density_root(edges[:, c] + (i + 0.5) * step) * step.sqrt()[:, None, None]
                moved = predict(belief, self._transition(command, step[:, None, None]), root, self.points)
                belief = moved.where(step > 0, belief)
        return belief

    def _held(self, memory: Memory, piece: int, since: Tensor) -> Tensor:
        """Commands (B, 1, M) that act in a piece which begins at ``since`` (B,)."""
        if self.further is None:
            return memory.command[:, max(piece - 1, 0), None]
        parts = []
        for k, delay in enumerate(self.further):
            acts = (memory.acts + delay).contiguous()
            newest = torch.searchsorted(acts, since[:, None].contiguous(), right=True) - 1
            parts.append(memory.command[..., k].gather(1, newest.clamp_min(0)))
        return torch.stack(parts, -1)

    def _transition(self, command: Tensor, h: Tensor) -> Callable[[Tensor], Tensor]:
        def step(state: Tensor) -> Tensor:
            k1 = self.derivative(state, command)
            k2 = self.derivative(state + 0.5 * h * k1, command)
            k3 = self.derivative(state + 0.5 * h * k2, command)
            k4 = self.derivative(state + h * k3, command)
            return state + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)

        return step

    def _density_root(self, time: Tensor) -> Tensor:
        if self._constant is not None:
            return self._constant.expand(len(time), *self._constant.shape[-2:])
        assert callable(self.density)
        return _root_of(self.density(time))


def system_derivative(system: System, parameters: Parameters) -> Derivative:
    """Equations of motion of a system (`deepkoco.systems.System`) in the form that the estimator needs.

    The efforts of actuators with a time constant are states behind the system's own, see `LagStates`: the state then
    has S + E entries, and `system_measurement` is what goes with it.

    Args:
        system: The system. Its delays are not included: `send` and `receive` take them, and ``further`` those of each
            command.
        parameters: Named values, each scalar or (B, 1).
    """
    lags = LagStates(system)

    def lagging(points: Tensor, command: Tensor) -> Tensor:
        target = system.actuate(system.effort_of(command), parameters)
        acting, slopes = lags.slopes(points, target.expand(*points.shape[:2], *target.shape[2:]), parameters)
        return torch.cat([system.derivative(lags.plain(points), acting, parameters), slopes], -1)

    def derivative(state: Tensor, command: Tensor) -> Tensor:
        effort = system.actuate(
            system.effort_of(command), parameters
        )  # (B, 1), or (B, 1, M) of several commands
        return system.derivative(state, effort.expand(*state.shape[:2], *effort.shape[2:]), parameters)

    return lagging if lags.commands else derivative


def system_measurement(system: System) -> Callable[[Tensor], Tensor]:
    """What sensors without any error show (B, K, N) of states (B, K, S + E) of `system_derivative`."""
    lags = LagStates(system)
    return lambda points: system.ideal_measurement(lags.plain(points))


def _root_of(density: Tensor) -> Tensor:
    """Root R with R R^T = density, for a symmetric positive semidefinite matrix."""
    values, vectors = torch.linalg.eigh(density)
    if not torch.allclose(density, density.mT) or bool((values < -1e-9 * values.abs().max()).any()):
        raise FilterError("noise_density is not symmetric and positive semidefinite")
    return vectors * values.clamp_min(0.0).sqrt()[..., None, :]
