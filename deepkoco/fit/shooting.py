"""Multiple shooting: predictions of all windows, with what a solver needs to know about the parameters."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Self

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.per_log_differences import effects_in
from deepkoco.fit.data.resolved import resolved
from deepkoco.fit.data.usual_steps import with_usual_steps
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit_types import Fit
from deepkoco.fit.simulate.push import Push, push_torque
from deepkoco.fit.simulate.simulator import is_compiled, predict
from deepkoco.fit.solve.encoder_zeros import EncoderZeros
from deepkoco.fit.solve.nuisances import Nuisances
from deepkoco.fit.threads import in_parts
from deepkoco.systems import ExtendedSystem, Parameter, System
from deepkoco.systems.effects.effect import PlacedEffect

# Measurements of one batch: the system need then not clear new memory for each.
MEASUREMENTS = 1 << 21
# As many times more where torch takes the steps: each operation of a step has a cost of its own, whatever its size.
IN_TORCH = 8
# Of a batch, the measurements and the steps of single joints that one thread simulates: some 0.1 s, and what it reads
# and writes stays in the cache.
MEASUREMENTS_EACH = 1 << 20
JOINT_STEPS_EACH = 1 << 20
SENSING_RANGE = 0.1  # longest delay of one channel [s]


class ShootingProblem:
    """The simulation of all windows as a function of parameters, initial states and nuisances.

    Args:
        system: The extended system; trials free some of its parameters.
        windows: Data.
        late: Channels that may lag behind their time stamps. Each has its own delay, the parameter
            ``<channel>.delay`` [s]; 0 is no lag.
        zero_sd: Standard deviation of encoder zeros from log to log [rad]; None takes the channels' declarations.

    Source: Bock, Recent advances in parameter identification (1983) for multiple shooting.
    """

    def __init__(
        self,
        system: ExtendedSystem,
        windows: Windows,
        late: tuple[str, ...] = (),
        zero_sd: float | None = None,
    ) -> None:
        self.system = system
        self.windows = windows
        self._late, self._zero_sd = late, zero_sd
        delays = channel_delays(late)
        self.late = tuple([c.name for c in system.measurements].index(name) for name in late)
        self.names = tuple(p.name for p in (*system.parameters, *delays)) + Push.NAMES
        declared = {p.name: p for p in (*system.parameters, *delays)} | resolved(system, windows)
        declared |= Push.declared(system, windows)
        self.low = np.array([declared[n].low for n in self.names])
        self.high = np.array([declared[n].high for n in self.names])
        self.scale = np.array([declared[n].prior_sd for n in self.names])
        self.weight = windows.valid.to(torch.float64) / windows.sample_sd
        self.whitening = windows.whitening()
        self.zeros = EncoderZeros.of(system, len(windows.commands), zero_sd)
        self.nuisances = Nuisances(self.zeros, windows.varies)
        self._kept: dict[tuple[str, ...], ExtendedSystem] = {}
        self._usual: Self | None = None
        self._uncut = False  # whether `_usual` would be this problem itself

    @property
    def most_lanes(self) -> int:
        """Largest number of lanes that are simulated in one batch."""
        most = MEASUREMENTS * (1 if self.compiled else IN_TORCH)
        return max(most // max(self.windows.value.numel(), 1), 1)

    @property
    def lanes_each(self) -> int:
        """Number of lanes that one thread simulates."""
        if not self.in_threads:
            return self.most_lanes
        steps = len(self.windows) * self.windows.steps * self.system.joints
        measurements = self.windows.value.numel()
        return max(min(JOINT_STEPS_EACH // max(steps, 1), MEASUREMENTS_EACH // max(measurements, 1)), 1)

    @cached_property
    def in_threads(self) -> bool:
        """Whether several threads may simulate at once: a user's class may keep something from call to call."""
        return self.compiled and type(self.system.base).__module__.partition(".")[0] == "deepkoco"

    @cached_property
    def compiled(self) -> bool:
        """Whether a compiled loop or bytecode takes the steps; else torch does."""
        return is_compiled(self.system.base, self.windows.step)

    def weighed(self, difference: Tensor) -> Tensor:
        """Return differences (..., W, N, M) of measurements as residuals count them: whitened, 0 where padded."""
        return self.whitened(difference * self.weight)

    def whitened(self, residual: Tensor) -> Tensor:
        """Return differences (..., W, N, M) in noise standard deviations without what noise of the commands does."""
        return residual if self.whitening is None else self.whitening.whitened(residual)

    def predict(self, theta: np.ndarray, initial: Tensor, nuisance: Tensor) -> Tensor:
        """Simulate measurements (L, W, N, M) for L lanes of parameters (L, P), states (L, W, S), nuisances (L, z)."""
        most = self.lanes_each
        if len(theta) <= most:
            return self._predict(theta, initial, nuisance)
        result = torch.empty(len(theta), *self.windows.value.shape, dtype=torch.float64)
        self.null_values()  # all threads use them

        def simulate(at: int, end: int) -> None:
            result[at:end] = self._predict(theta[at:end], initial[at:end], nuisance[at:end])

        in_parts(simulate, len(theta), most, alone=not self.in_threads)
        return result

    def _predict(self, theta: np.ndarray, initial: Tensor, nuisance: Tensor) -> Tensor:
        """As :meth:`predict`, in one batch."""
        own = len(self.system.parameters)
        nulls = self.null_values()
        values = theta[:, :own].copy()
        for j in self._limits:
            # The null value of a saturation is the command limit. With a gain or a bias, the effort can exceed it.
            values[:, j] = np.where(values[:, j] >= nulls[j], np.inf, values[:, j])
        given = (theta[:, :own] != nulls).T
        lanes: dict[str, slice] = {}
        slow = np.zeros(len(theta), dtype=bool)
        for columns in self._slow_columns:
            slow |= given[columns].any(0)
        if slow.any() and not slow.all():
            # A few lanes with effects that the system's compiled loop does not know must not keep the others from it.
            result = torch.empty(len(theta), *self.windows.value.shape, dtype=torch.float64)
            for part in (slow, ~slow):
                pick = torch.from_numpy(part)
                result[pick] = self._predict(theta[part], initial[pick], nuisance[pick])
            return result
        for effect, columns in self._columns.items():
            acting = np.flatnonzero(given[columns].any(0))
            if len(acting):
                lanes[effect] = slice(int(acting[0]), int(acting[-1]) + 1)
        differing = effects_in((*self.windows.known, self.windows.varies))
        lanes |= {effect: slice(0, len(theta)) for effect in differing}
        # Effects at their null value in every lane would only cost time.
        system = self._extended(tuple(lanes))
        same = (values == values[:1]).all(0)
        named = {
            n: torch.tensor(values[0, j]) if same[j] else torch.from_numpy(np.ascontiguousarray(values[:, j]))
            for j, n in enumerate(self.names[:own])
            if "." not in n or n.split(".")[0] in lanes
        }
        push = push_torque(self.windows, theta[:, -len(Push.NAMES) :], self.system)
        delays = {c: torch.from_numpy(theta[:, own + k]) for k, c in enumerate(self.late)}
        # An effect that acts in all lanes needs no slice.
        some = {effect: part for effect, part in lanes.items() if part.stop - part.start < len(theta)}
        differ = self.nuisances.differ(nuisance)
        result = predict(system, self.windows, named, initial, push, delays, some, differ)
        self.zeros.add(result, nuisance, self.windows.log)
        return result

    def of_windows(self, index: Tensor) -> Self:
        """The same problem with some of its windows only; systems that were made for simulations are shared."""
        part = copy.copy(self)
        part.windows, part.weight = self.windows.take(index.numpy()), self.weight[index]
        part.whitening = None if self.whitening is None else self.whitening.take(index)
        part._usual, part._uncut = None, False
        return part

    @property
    def with_usual_steps(self) -> Self:
        """The same problem without cuts of its integration steps, for differences of simulations.

        The error of a step hardly changes from one simulation to the next, so it hardly shows in their difference.
        """
        if self._uncut:
            return self
        if self._usual is None:
            windows = with_usual_steps(self.windows, self.system)
            if windows is self.windows:
                self._uncut = True
                return self
            self._usual = copy.copy(self)
            self._usual.windows = windows
        return self._usual

    def nuisance_slopes(self, parameters: Tensor) -> Tensor:
        """(z, W, N, M) weighted derivatives by the nuisances, from those by the parameters that vary (V, W, N, M)."""
        return self.nuisances.slopes(self.weight, self.windows.log, parameters, self.whitened)

    def values_in(self, fit: Fit, log: int | None = None) -> dict[str, float]:
        """Parameters of one log after a fit; without ``log``, their mean over the logs of these windows."""
        differ = self.nuisances.differ(fit.nuisance[None])
        seen = np.unique(self.windows.log) if log is None else [log]
        values = dict(fit.values)
        for name, own in differ.items():
            j = self.names.index(name)
            # Differences of single logs are not limited by the bounds.
            values[name] = float(np.clip(values[name] + float(own[seen].mean()), self.low[j], self.high[j]))
        return values

    def null_values(self) -> np.ndarray:
        """(P,) values at which the effects change nothing; NaN for the parameters of the base system."""
        if not hasattr(self, "_nulls"):
            bare = ExtendedSystem(self.system.base, tuple(e.name for e in self.system.effects))
            self._nulls = np.array([p.value if "." in p.name else np.nan for p in bare.parameters])
            self._limits = [j for j, p in enumerate(bare.parameters) if p.name.endswith(".limit")]
            self._columns: dict[str, list[int]] = {}
            base = self.system.base
            slow = {e.name for e in self.system.effects if not base.rolls(e.effect)}
            idle = {f"{e.name}.{n}" for e in self.system.effects for n in _idle(e, base)}
            for j, p in enumerate(bare.parameters):
                if "." in p.name and p.name not in idle:
                    self._columns.setdefault(p.name.split(".")[0], []).append(j)
            self._slow_columns = [columns for effect, columns in self._columns.items() if effect in slow]
        return self._nulls

    def _extended(self, effects: tuple[str, ...]) -> ExtendedSystem:
        """The base system with these effects only. Systems are cached: a fit uses few combinations."""
        if effects not in self._kept:
            self._kept[effects] = ExtendedSystem(self.system.base, effects)
        return self._kept[effects]


def _idle(placed: PlacedEffect, base: System) -> set[str]:
    """Parameters of an effect that change nothing while all others are null: the ranges by which loads are scaled."""
    null = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in placed.parameters(base)}
    kept = set(placed.effect.acting(null))
    return kept if len(kept) < len(null) else set()


def channel_delays(channels: Sequence[str]) -> tuple[Parameter, ...]:
    """Declare the delay parameter of each of these channels."""
    text = "delay of this channel, state to time stamp of its measurement"
    return tuple(Parameter(f"{c}.delay", 0.0, "s", 0.0, SENSING_RANGE, 0.02, text) for c in channels)
