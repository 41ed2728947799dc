"""Cut recordings into windows of equal length for multiple shooting."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.late_stamps import unsure_spans
from deepkoco.fit.data.noise import Noise, estimate_noise, rates
from deepkoco.fit.data.per_log_differences import Known, known_of
from deepkoco.fit.data.rest import resting_stamps
from deepkoco.fit.data.series import CommandSeries, channel_series, scatter_taken_out
from deepkoco.fit.data.step_grid import grid_of_commands, grid_of_own_steps
from deepkoco.fit.data.unseen_positions import unseen_positions
from deepkoco.fit.data.wander import Wander, Whitening
from deepkoco.fit.data.way_before import hidden_by, ways_of
from deepkoco.logs.recording import Recording
from deepkoco.systems import Motion, System

LONGEST_STEP = 0.01  # integration step [s]
# Smallest number of integration steps in a period of the fastest small motion. The classical Runge-Kutta method then
# shifts its phase by 2 pi (2 pi / 50)^4 / 120 = 1.3e-5 rad in a period.
STEPS_PER_PERIOD = 50
FEWEST_STEPS = 20  # of a window: its missing load is shown in as many pieces
HISTORY = 0.1  # commands must be known for this time before a window, because of delays and lags [s]
WARM_UP = 0.15  # or this share of a window; a slow lag then forgets commands from before the log
EARLY = 1e-6  # share of a step by which a command may be before the start of a window
MIN_SAMPLES = 6  # smallest number of samples of a channel in a window
STANDSTILL = 8.0  # peak-to-peak motion, in noise standard deviations, below which a joint rests
MIN_MOVING_WINDOWS = 4  # windows with rest are used too if fewer windows than this are without


@dataclass(frozen=True)
class Windows:
    """W windows of one length, from one or several logs of one system.

    Attributes:
        commands: Command series of each log: the most likely ones where ``wander`` says that rows hold noise.
        log: (W,) index of the window's log.
        t0: (W,) start in its log's time [s].
        step: Integration step [s].
        steps: Number of integration steps in a window.
        t: (W, N, M) stamps of the measurements after ``t0`` [s], 0 where padded.
        value: (W, N, M) measurements in the channels' units, angles unwrapped.
        valid: (W, N, M) True where there is a sample.
        noise: One per channel.
        state: (W, S) first guess of the initial states.
        rests: (W,) True where the joint rests for a while inside or across an end of the window.
        shows: Index of the state that each channel measures.
        known: Known differences of each log; empty if there are none.
        varies: Parameter -> standard deviation between logs, in its unit; empty if all logs share their parameters.
        stamp_sd: Standard deviation of each log's time stamps [s]; empty where all stamps are exact.
        way: (W, J, P) positions of the joints at their last turning points before the window and at its start, see
            :mod:`.way_before`; None where no log tells.
        unseen: Per joint, the way up to which noise of its encoder hid a motion from ``way``; 0 without an encoder.
        taken_out: Per channel, the standard deviation by which its stamps scattered about the even times that took
            their place [s], see :mod:`.even_stamps`; empty where none did.
        own_steps: Whether the integration steps are the system's own, which nobody cuts: :attr:`.System.own_step`.
        doubt: (W, N) factor of the noise of a channel in a window, at least 1; None for 1. See :mod:`..solve.robust`.
        wander: What noise of the commands does to the measurements; None where they act as logged. See :mod:`.wander`.
    """

    commands: tuple[CommandSeries, ...]
    log: np.ndarray
    t0: np.ndarray
    step: float
    steps: int
    t: Tensor
    value: Tensor
    valid: Tensor
    noise: tuple[Noise, ...]
    state: Tensor
    rests: np.ndarray
    shows: tuple[int, ...] = (0, 1)
    known: Known = ()
    varies: Mapping[str, float] = field(default_factory=dict)
    stamp_sd: tuple[float, ...] = ()
    doubt: Tensor | None = None
    way: Tensor | None = None
    unseen: tuple[float, ...] = ()
    taken_out: tuple[float, ...] = ()
    own_steps: bool = False
    wander: Wander | None = None

    def __len__(self) -> int:
        return len(self.t0)

    @property
    def length(self) -> float:
        """Length of a window [s]."""
        return self.step * self.steps

    @property
    def samples(self) -> int:
        """Number of measured values in all windows."""
        return int(self.valid.sum())

    @property
    def sample_sd(self) -> Tensor:
        """(W, N, M) noise of every sample in its channel's unit: sqrt(r^2 + (rate sigma_t)^2); at least (1, N, 1).

        A stamp that is wrong by dt shows the value of another time, so the error is the channel's rate times dt. The
        doubt about a window multiplies r.
        """
        sd = torch.tensor([n.sd for n in self.noise], dtype=torch.float64)[None, :, None]
        sd = sd if self.doubt is None else sd * self.doubt[..., None]
        if not any(self.stamp_sd):
            return sd
        stamps = torch.tensor(self.stamp_sd, dtype=torch.float64)[torch.from_numpy(self.log)]
        rate = rates(self.t.numpy(), self.value.numpy(), self.valid.numpy())
        return torch.sqrt(sd**2 + (stamps[:, None, None] * torch.from_numpy(rate)) ** 2)

    def whitening(self) -> Whitening | None:
        """How residuals in noise standard deviations are whitened; None where they are not."""
        if self.wander is None:
            return None
        # A doubt about a window multiplies this noise, too.
        return self.wander.whitening(self.valid.to(torch.float64) / replace(self, doubt=None).sample_sd)

    def errors(self, residual: Tensor) -> Tensor:
        """Return measured minus simulated values (W, N, M) in the channels' units, from the residuals of a fit."""
        whitening = self.whitening()
        return (residual if whitening is None else whitening.as_measured(residual)) * self.sample_sd

    def prolonged(self, seconds: float) -> Windows:
        """The same windows with integration steps for a time beyond their end; the measurements stay."""
        return replace(self, steps=self.steps + math.ceil(seconds / self.step)) if seconds > 0.0 else self

    def take(self, keep: np.ndarray) -> Windows:
        """Select windows by indices or by a mask (W,)."""
        index = np.flatnonzero(keep) if keep.dtype == bool else keep
        pick = torch.as_tensor(index)
        return replace(
            self,
            log=self.log[index],
            t0=self.t0[index],
            t=self.t[pick],
            value=self.value[pick],
            valid=self.valid[pick],
            state=self.state[pick],
            rests=self.rests[index],
            doubt=None if self.doubt is None else self.doubt[pick],
            way=None if self.way is None else self.way[pick],
            wander=None if self.wander is None else self.wander.take(pick),
        )

    def with_value(self, value: Tensor) -> Windows:
        """The same windows with other measurements (W, N, M)."""
        return replace(self, value=value)


def window_length(system: System) -> float:
    """About one period of the system's small motion, between 1 and 2 s.

    Shorter windows do not show slow effects. In longer windows, simulations of an unstable motion diverge.
    """
    return float(np.clip(period(system), 1.0, 2.0))


def period(system: System) -> float:
    """Period of the system's fastest small motion at zero command [s]; 1.5 where it has none."""
    law = system.accelerations(system.default_parameters())
    eps = 1e-6
    angles = torch.linspace(0.0, 2.0 * math.pi, 17, dtype=torch.float64)
    rest = (torch.zeros_like(angles),) * system.joints
    commands = (torch.zeros_like(angles),) * len(system.commands)
    stiffness = 0.0
    for j in range(system.joints):
        shifted = tuple(angles + eps if i == j else angles for i in range(system.joints))
        before = law(Motion((angles,) * system.joints, rest, commands))[j]
        after = law(Motion(shifted, rest, commands))[j]
        stiffness = max(stiffness, float((before - after).max()) / eps)
    return 2.0 * math.pi / math.sqrt(stiffness) if stiffness > 0 else 1.5


def integration_step(system: System) -> float:
    """Longest integration step of a fit [s]: what the system declares, or a share of its period."""
    declared = system.longest_step
    return min(LONGEST_STEP, declared if math.isfinite(declared) else period(system) / STEPS_PER_PERIOD)


def cut_windows(
    recordings: Sequence[Recording],
    system: System,
    length: float,
    noise: tuple[Noise, ...] | None = None,
    cover: bool = False,
) -> Windows:
    """Cut logs into windows, back to back.

    Args:
        recordings: Logs of the system; each has the commands and at least one measurement.
        system: Gives the channels.
        length: Length of a window [s]; it is rounded to whole steps of commands that come at a regular rate.
        noise: Noise of each channel; None estimates it from these logs.
        cover: True lets neighbouring windows overlap, so that they cover each log to its end.

    Raises:
        LogError: A log lacks a command or every measurement.
    """
    channels = [channel_series(recording, system) for recording in recordings]
    longest = min(integration_step(system), length / FEWEST_STEPS)
    stamps = [command.t for command, _ in channels if command.changes]
    if system.own_step is None:
        step, steps, regular = grid_of_commands(stamps, length, longest)
    else:
        step, steps, regular = grid_of_own_steps(stamps, length, system.own_step)
    length = step * steps
    names = [channel.name for channel in system.measurements]
    noise = estimate_channels(recordings, system) if noise is None else noise
    commands, rows = [], []
    for index, recording in enumerate(recordings):
        command, series = channels[index]
        commands.append(command)
        still = resting_stamps(system, series, noise, length)
        unknown = [
            *recording.unknown,
            *(span for t, value in series.values() for span in unsure_spans(t, [value])),
        ]
        history = 0.0 if cover else max(HISTORY, WARM_UP * length)
        start = max(min(t[0] for t, _ in series.values()), command.t[0] + history)
        if regular and command.changes and start < command.t[-1]:
            start = float(command.t[np.searchsorted(command.t, start - EARLY * step)])
        stop = min(max(t[-1] for t, _ in series.values()), command.t[-1] + length)
        for t0 in _starts(start, stop, length, cover, step if system.own_step is not None else 0.0):
            if any(begin < t0 + length and end > t0 - HISTORY for begin, end in unknown):
                continue
            pieces = {n: _piece(*series[n], t0, t0 + length) for n in names if n in series}
            if any(len(t) >= MIN_SAMPLES for t, _ in pieces.values()):
                inside = still is not None and bool(((still >= t0) & (still < t0 + length)).any())
                rows.append((index, t0, pieces, inside))
    unseen = hidden_by(noise, system)
    log, t0s = (np.array([row[k] for row in rows], dtype=kind) for k, kind in ((0, int), (1, float)))
    way = ways_of(recordings, [series for _, series in channels], log, t0s, system, unseen)
    size = max((len(t) for _, _, pieces, _ in rows for t, _ in pieces.values()), default=0)
    shape = (len(rows), len(names), size)
    t, value, valid = np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=bool)
    for w, (_, t0, pieces, _) in enumerate(rows):
        for c, name in enumerate(names):
            stamps, values = pieces.get(name, (np.empty(0), np.empty(0)))
            t[w, c, : len(stamps)] = stamps - t0
            value[w, c, : len(stamps)] = values
            valid[w, c, : len(stamps)] = True
    shows = system.measured_states
    state = np.array([first_state(t[w], value[w], valid[w], shows, system.joints) for w in range(len(rows))])
    state = state.reshape(-1, 2 * system.joints)
    state[:, : system.joints] += unseen_positions(
        [series for _, series in channels], names, shows, system.joints, log, t0s
    )
    return Windows(
        tuple(commands),
        log,
        t0s,
        step,
        steps,
        torch.from_numpy(t),
        torch.from_numpy(value),
        torch.from_numpy(valid),
        noise,
        torch.from_numpy(state),
        np.array([row[3] for row in rows], dtype=bool),
        shows,
        known_of(recordings, system),
        way=torch.from_numpy(way),
        unseen=unseen,
        taken_out=scatter_taken_out(recordings, [series for _, series in channels], names),
        own_steps=system.own_step is not None,
    )


def estimate_channels(recordings: Sequence[Recording], system: System) -> tuple[Noise, ...]:
    """Noise of each measurement channel: variances of the logs, weighted by their numbers of samples."""
    result = []
    for channel in system.measurements:
        parts = []
        for recording in recordings:
            _, series = channel_series(recording, system)
            if channel.name in series:
                parts.append(
                    (len(series[channel.name][0]), estimate_noise(*series[channel.name], channel.noise_sd))
                )
        total = sum(n for n, _ in parts)
        if total == 0:
            result.append(Noise(channel.noise_sd, 0.0))
            continue
        variance = sum(n * noise.sd**2 for n, noise in parts) / total
        spread = sum((n * noise.relative_sd) ** 2 for n, noise in parts) ** 0.5 / total
        result.append(Noise(math.sqrt(variance), spread))
    return tuple(result)


def moving(windows: Windows) -> np.ndarray:
    """(W,) True where the joint moves without a rest.

    A joint at rest gives no information about its dynamics. A simulation without dry friction cannot follow a window
    in which the joint rests for a while. Windows with such a rest are left out too, unless too few remain.
    """
    moves = np.zeros(len(windows), dtype=bool)
    for c, noise in enumerate(windows.noise):
        value, valid = windows.value[:, c].numpy(), windows.valid[:, c].numpy()
        high = np.where(valid, value, -math.inf).max(-1, initial=-math.inf)
        low = np.where(valid, value, math.inf).min(-1, initial=math.inf)
        moves |= (high - low) > STANDSTILL * noise.sd
    keep = moves & ~windows.rests
    return keep if keep.sum() >= max(MIN_MOVING_WINDOWS, 0.3 * moves.sum()) else moves


def _starts(start: float, stop: float, length: float, cover: bool, own: float) -> np.ndarray:
    """Starts of the windows between two times; with ``cover``, up to 2 % of a window may stay uncovered.

    They are whole steps apart where the system has steps of its own [s]; 0 where it has none.
    """
    fit = (stop - start) / length
    if fit < 1.0 - 1e-9:
        return np.zeros(0)
    if cover:
        apart = np.linspace(0.0, stop - length - start, math.ceil(fit - 0.02))
        return start + (apart if own == 0.0 else own * np.floor(apart / own + EARLY))
    return start + length * np.arange(int(fit + 1e-9))


def _piece(t: np.ndarray, value: np.ndarray, start: float, stop: float) -> tuple[np.ndarray, np.ndarray]:
    first, last = np.searchsorted(t, [start - 1e-9, stop - 1e-9])
    return t[first:last], value[first:last]


def first_state(
    t: np.ndarray, value: np.ndarray, valid: np.ndarray, shows: tuple[int, ...], joints: int
) -> np.ndarray:
    """First guess of positions and speeds at the window's start: parabolas through the first samples."""
    state = np.zeros(2 * joints)
    for c, s in enumerate(shows):
        n = min(int(valid[c].sum()), 7)
        if s < joints and n >= 3:
            # Position and speed are constant and slope of the parabola.
            _, state[joints + s], state[s] = np.polyfit(t[c, :n], value[c, :n], 2)
    for c, s in enumerate(shows):
        n = min(int(valid[c].sum()), 3)
        if joints <= s < 2 * joints and n:  # a channel may show none of the states
            state[s] = float(value[c, :n].mean())
    return state
