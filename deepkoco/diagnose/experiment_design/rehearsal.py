"""Simulation of command sequences, cut into windows as in a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from deepkoco.diagnose.experiment_design.experiment_setup import Stage, nothing
from deepkoco.fit.data.windows import (
    HISTORY,
    CommandSeries,
    Windows,
    cut_windows,
    integration_step,
    moving,
)
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.simulate.simulator import integrate
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem, Motion

SUBSTEP = 0.01  # time step of the closed loop [s]


@dataclass(frozen=True)
class Rehearsal:
    """Simulation of K sequences on U units; sequence k on unit u is log u K + k.

    Attributes:
        commands: (U K, n, M) sent commands, including the feedback.
        time: (T,) times of the path [s].
        path: (U K, T, S) states.
        excess: (U K,) excess over the limits, as a share of them; 0 where they are kept.
        windows: Moving windows of all logs, with the states of the unit.
    """

    commands: np.ndarray
    time: np.ndarray
    path: np.ndarray
    excess: np.ndarray
    windows: Windows


def rehearse(stage: Stage, feedforward: np.ndarray, units: Sequence[Mapping[str, float]]) -> Rehearsal:
    """Simulate sequences on units.

    Args:
        stage: The experiment.
        feedforward: (K, n, M) commands.
        units: Parameters of each unit, every name of the stage's system.
    """
    acting, named = acting_model(stage.system, units)
    count, lanes = len(feedforward), len(units)
    tiled = np.tile(feedforward, (lanes, 1, 1))
    if stage.hold is None:
        sent, driven = tiled, feedforward
    else:
        # The feedback depends on the motion of each unit, so each unit has its own commands.
        each = {n: v if v.ndim == 0 else v.repeat_interleave(count) for n, v in named.items()}
        sent = driven = _closed_loop(stage, tiled, acting, each)
    whole = _whole(stage, driven)
    first = torch.from_numpy(stage.initial).expand(lanes, len(driven), -1)
    nodes = integrate(acting, whole, named, first)
    states = torch.stack(nodes.value, -1).permute(2, 1, 0, 3)  # (U, K or U K, T, S)
    if stage.hold is None:
        states = states.flatten(0, 1)
    else:
        states = torch.cat([states[u, u * count : (u + 1) * count] for u in range(lanes)])
    time = whole.t0[0] + whole.step * np.arange(whole.steps + 1)
    path = states.numpy()
    excess = _excess(stage, path)
    # A feedback can make the simulation of a stiff robot diverge: such a sequence exceeds all limits.
    diverged = ~(np.isfinite(path).all((1, 2)) & np.isfinite(sent).all((1, 2)))
    excess[diverged] = np.inf
    if diverged.any():
        sent, path = sent.copy(), path.copy()
        sent[diverged], path[diverged] = 0.0, 0.0
        states = torch.from_numpy(path)
    recordings = [_recording(stage, sent[k], time, path[k]) for k in range(len(sent))]
    windows = cut_windows(recordings, stage.system.base, stage.window, stage.noise)
    if len(windows):
        at = np.round((windows.t0 - whole.t0[0]) / whole.step).astype(int)
        windows = replace(windows, state=states[torch.from_numpy(windows.log), torch.from_numpy(at)])
        windows = windows.take(_kept(windows))
    return Rehearsal(sent, time, path, excess, windows)


def measured(stage: Stage, played: Rehearsal, values: Mapping[str, float]) -> Windows:
    """Return the windows of a simulation with the noise-free measurements of the simulated model."""
    windows = played.windows
    problem = FitProblem(stage.system, windows)
    theta = np.array([[values[n] for n in problem.names]])
    exact = problem.predict(theta, windows.state[None], problem.zeros.none()[None])[0]
    return windows.with_value(torch.where(windows.valid, exact, 0.0))


def acting_model(
    system: ExtendedSystem, units: Sequence[Mapping[str, float]]
) -> tuple[ExtendedSystem, dict[str, torch.Tensor]]:
    """Return the system with only those effects that some unit has, and its parameters: scalars, or (U,) if unequal."""
    bare = ExtendedSystem(system.base, tuple(e.name for e in system.effects))
    null = {p.name: p.value for p in bare.parameters}
    moved = {n.split(".")[0] for n in null if "." in n and any(unit[n] != null[n] for unit in units)}
    acting = ExtendedSystem(system.base, tuple(moved))
    named = {}
    for p in acting.parameters:
        values = [float(unit[p.name]) for unit in units]
        if p.name.endswith(".limit"):
            # At its null value a saturation cuts no command, but together with a gain it would cut efforts.
            values = [v if v < null[p.name] else math.inf for v in values]
        same = len(set(values)) == 1
        named[p.name] = torch.tensor(values[0] if same else values, dtype=torch.float64)
    return acting, named


def _kept(windows: Windows) -> np.ndarray:
    """Return (W,) which windows move, for each log separately, because `moving` uses the share of moving windows."""
    keep = np.zeros(len(windows), dtype=bool)
    for log in np.unique(windows.log):
        own = windows.log == log
        keep[own] = moving(windows.take(own))
    return keep


def _whole(stage: Stage, sent: np.ndarray) -> Windows:
    """Return one window over the whole experiment for each sequence, with the time nodes of the short windows."""
    base = stage.system.base
    step = stage.window / math.ceil(stage.window / integration_step(base) - 1e-9)
    early = math.ceil(HISTORY / step)
    time = stage.frame.time
    return replace(
        nothing(base),
        commands=tuple(CommandSeries(time, u[:, 0] if u.shape[1] == 1 else u) for u in sent),
        log=np.arange(len(sent)),
        t0=np.full(len(sent), HISTORY - early * step),
        step=step,
        steps=early + math.ceil((stage.frame.seconds - HISTORY) / step),
    )


def _recording(stage: Stage, sent: np.ndarray, time: np.ndarray, path: np.ndarray) -> Recording:
    base = stage.system.base
    stamps = np.arange(math.floor(stage.frame.seconds * stage.sensor_rate)) / stage.sensor_rate
    channels = {
        c.name: Series(stage.frame.time, sent[:, k], c.unit, "command") for k, c in enumerate(base.commands)
    }
    for c, s in zip(base.measurements, base.measured_states, strict=True):
        channels[c.name] = Series(stamps, np.interp(stamps, time, path[:, s]), c.unit, "measurement")
    return Recording(channels, None, base.name)


def _excess(stage: Stage, path: np.ndarray) -> np.ndarray:
    joints, limits = stage.system.joints, stage.limits
    position, speed = path[..., :joints], np.abs(path[..., joints:])
    low, high = limits.position.T
    reach = np.where(np.isfinite(high - low), high - low, 1.0)
    over = np.maximum(position - high, low - position) / reach
    fast = speed / limits.speed - 1.0
    worst = np.maximum(over.max((1, 2)), fast.max((1, 2)))
    return np.where(np.isfinite(path).all((1, 2)), np.maximum(worst, 0.0), np.inf)


def _closed_loop(
    stage: Stage, feedforward: np.ndarray, system: ExtendedSystem, named: dict[str, torch.Tensor]
) -> np.ndarray:
    """Return the commands (K, n, M) including the feedback, from a simulation tick by tick."""
    assert stage.hold is not None
    law, joints = system.accelerations(named), system.joints
    gain, place = (torch.from_numpy(x) for x in (stage.hold.gain, stage.hold.place))
    low, high = (torch.from_numpy(x.copy()) for x in stage.limits.command.T)
    count = len(feedforward)
    state = torch.from_numpy(stage.initial).repeat(count, 1)
    lags = [
        [lag for lag in system.command_timing(k, named).lag if bool((lag > 0.0).any())]
        for k in range(len(system.commands))
    ]
    rest = torch.from_numpy(np.ascontiguousarray(stage.rest))
    slow = [[rest[k].expand(count) for _ in chain] for k, chain in enumerate(lags)]
    ticks = 1.0 / stage.frame.rate
    parts = max(1, math.ceil(ticks / SUBSTEP))
    h = ticks / parts
    sent = np.empty_like(feedforward)

    def rates(x: torch.Tensor, efforts: tuple[torch.Tensor, ...], t: float) -> torch.Tensor:
        columns = x.unbind(-1)
        time = torch.full((count,), t, dtype=torch.float64)
        moved = law(Motion(columns[:joints], columns[joints:], efforts, time=time))
        return torch.stack(torch.broadcast_tensors(*columns[joints:], *moved), -1)

    for i in range(feedforward.shape[1]):
        command = torch.from_numpy(feedforward[:, i]) - (state - place) @ gain.T
        command = torch.minimum(torch.maximum(command, low), high)
        sent[:, i] = command.numpy()
        for part in range(parts):
            efforts = []
            for k, chain in enumerate(lags):
                given = command[:, k]
                for n, constant in enumerate(chain):
                    slow[k][n] = given + (slow[k][n] - given) * torch.exp(-h / constant)
                    given = slow[k][n]
                efforts.append(given)
            t, acting = (i * parts + part) * h, tuple(efforts)
            k1 = rates(state, acting, t)
            k2 = rates(state + 0.5 * h * k1, acting, t + 0.5 * h)
            k3 = rates(state + 0.5 * h * k2, acting, t + 0.5 * h)
            k4 = rates(state + h * k3, acting, t + h)
            state = state + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return sent
