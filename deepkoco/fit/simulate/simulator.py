"""Simulate all windows for all lanes in one batch. A lane is one set of parameters and initial states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.per_log_differences import amounts, of_windows
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.simulate.command_effort import command_efforts
from deepkoco.fit.simulate.nodes import Nodes
from deepkoco.fit.simulate.play import behind_play
from deepkoco.fit.simulate.sensor_filter import filtered
from deepkoco.fit.simulate.step import (
    Drive,
    Equations,
    Step,
    corrected,
    directions,
    replaced,
    rows_of,
    step_of,
    turning,
)
from deepkoco.systems import ExtendedSystem, System
from deepkoco.systems.channel_delay import ahead_of_latest, latest
from deepkoco.systems.dry_friction import Levels
from deepkoco.systems.motion import Motion
from deepkoco.systems.rollout import RolloutInput


def trajectories(
    system: System,
    windows: Windows,
    parameters: Mapping[str, Tensor],
    initial: Tensor,
    push: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Simulate every window under its logged commands.

    Args:
        system: Dynamics.
        windows: W windows of n steps.
        parameters: Named values, each (L,) or scalar.
        initial: (L, W, S) states at the start of the windows.
        push: (J, L, W, n) extra load on each joint over each step [N m or N]; None for none.

    Returns:
        States (n + 1, L, W, S), derivative at the start and at the end of each step (n, L, W, S).

    Source: classical Runge-Kutta with an effort that is linear in time within the step.
    """
    nodes = integrate(system, windows, parameters, initial, push)
    states, left, right = (torch.stack(part, -1).transpose(1, 2) for part in nodes)
    return states, left, right


def integrate(
    system: System,
    windows: Windows,
    parameters: Mapping[str, Tensor],
    initial: Tensor,
    push: Tensor | None = None,
    lanes: Mapping[str, slice] | None = None,
    differ: Mapping[str, Tensor] | None = None,
) -> Nodes:
    """As :func:`trajectories`.

    Args:
        system, windows, parameters, initial, push: As there.
        lanes: Effect -> lanes in which it acts; None for all.
        differ: Parameter -> (K, L) differences in each of K logs, in addition to the known ones.
    """
    h, joints, count = windows.step, system.joints, initial.shape[0]
    apart = amounts(windows.known, differ)
    own = of_windows(parameters, apart, windows.log)
    equations = _equations(system, own, lanes)
    start, slope = zip(
        *(command_efforts(system, windows, parameters, count, k, apart) for k in range(len(system.commands))),
        strict=True,
    )
    pushes = None if push is None else push.permute(3, 0, 2, 1).contiguous()  # (n, J, W, L)
    parts = initial.permute(2, 1, 0).contiguous().unbind(0)
    compiled = system.rollout(own)
    if compiled is not None:
        t0 = torch.from_numpy(windows.t0)[:, None]
        loads = None if push is None else push.permute(0, 3, 2, 1)
        given = RolloutInput(h, parts, t0, start, slope, loads, equations.friction)
        if (found := compiled.run(given)) is not None:
            fast = found.value[joints:]
            return Nodes(
                found.value, (*(v[:-1] for v in fast), *found.first), (*(v[1:] for v in fast), *found.last)
            )
    angle, speed = parts[:joints], parts[joints:]
    angles, speeds = [angle], [speed]
    firsts, lasts = [], []
    rest: Levels = (None,) * joints
    half = 0.5 * h
    time = torch.from_numpy(windows.t0)[:, None]
    # Terms that do not depend on the motion are computed for all steps at once, because calls of torch are slow.
    offsets = torch.tensor([i * h for i in range(windows.steps)], dtype=torch.float64)[:, None, None]
    at = [(time + offsets + later).unbind(0) for later in (0.0, half, h)]
    efforts = [_over_steps(start, slope, later) for later in (0.0, half, h)]
    loads = [None] * windows.steps if pushes is None else [p.unbind(0) for p in pushes.unbind(0)]
    remembered = _first_memory(equations, angle, speed, efforts, loads, time)
    for i in range(windows.steps):
        begin, middle, end = (effort[i] for effort in efforts)
        t1, t2, t4 = (t[i] for t in at)
        drive = Drive((begin, middle, end), (t1, t2, t4), loads[i], remembered)
        direction = directions(speed, rest, equations.friction)
        step = step_of(equations, angle, speed, drive, direction, h)
        rows = turning(speed, step.speed, equations.friction)
        if len(rows) == len(windows) or (len(rows) and apart):
            # Parameters that differ from log to log have one value per window.
            step = corrected(equations, step, angle, speed, drive, direction, h)
        elif len(rows):
            step = _corrected_in(rows, equations, step, angle, speed, drive, direction, h)
        if remembered:
            now = Motion(step.angle, step.speed, end, None, t4, equations.smoothing)
            remembered = equations.memory.advanced(remembered, angle, now)
        angle, speed = step.angle, step.speed
        angles.append(angle)
        speeds.append(speed)
        firsts.append(step.first)
        lasts.append(step.last)
        rest = step.rest
    value = tuple(torch.stack([x[j] for x in path]) for path in (angles, speeds) for j in range(joints))
    first = tuple(torch.stack([x[j] for x in firsts]) for j in range(joints))
    last = tuple(torch.stack([x[j] for x in lasts]) for j in range(joints))
    fast = value[joints:]
    return Nodes(value, (*(v[:-1] for v in fast), *first), (*(v[1:] for v in fast), *last))


def _equations(
    system: System, parameters: Mapping[str, Tensor], lanes: Mapping[str, slice] | None
) -> Equations:
    smoothing = tuple(torch.full((), speed, dtype=torch.float64) for speed in system.smoothing_speeds)
    inverse = system.inverse_inertia(parameters)
    if not isinstance(system, ExtendedSystem):
        free, friction = system.free_accelerations(parameters), system.dry_friction_levels(parameters)
        return Equations(free, friction, inverse, smoothing)
    free, friction = (
        system.free_accelerations(parameters, lanes),
        system.dry_friction_levels(parameters, lanes),
    )
    return Equations(free, friction, inverse, smoothing, system.joint_memory(parameters))


def _first_memory(
    equations: Equations,
    angle: tuple[Tensor, ...],
    speed: tuple[Tensor, ...],
    efforts: list[list[tuple[Tensor, ...]]],
    loads: Sequence[tuple[Tensor, ...] | None],
    time: Tensor,
) -> tuple[Tensor, ...]:
    """What effects remember at the start of the windows; nothing where none does."""
    if not equations.memory.parts or not loads:
        return ()
    motion = Motion(angle, speed, efforts[0][0], loads[0], time, equations.smoothing)
    inverse = equations.inverse(motion)
    needed = tuple(-a / inverse[j][j] for j, a in enumerate(equations.free(motion)))
    return equations.memory.start(motion, needed)


def _corrected_in(
    rows: Tensor,
    equations: Equations,
    step: Step,
    angle: tuple[Tensor, ...],
    speed: tuple[Tensor, ...],
    drive: Drive,
    direction: Levels,
    h: float,
) -> Step:
    """As :func:`corrected`, in some windows only."""
    first, last = rows_of(step.first, rows), rows_of(step.last, rows)
    own = Step(rows_of(step.angle, rows), rows_of(step.speed, rows), first, last, step.rest)
    share = tuple(None if x is None else x.index_select(0, rows) for x in direction)
    part = corrected(equations, own, rows_of(angle, rows), rows_of(speed, rows), drive.rows(rows), share, h)
    return replaced(step, rows, part)


def _over_steps(
    start: tuple[Tensor, ...], slope: tuple[Tensor, ...], later: float
) -> list[tuple[Tensor, ...]]:
    """Efforts of every command (W, L) at a time after the start of each of the n steps."""
    values = [a if later == 0.0 else torch.add(a, b, alpha=later) for a, b in zip(start, slope, strict=True)]
    return list(zip(*(v.unbind(0) for v in values), strict=True))


def predict(
    system: System,
    windows: Windows,
    parameters: Mapping[str, Tensor],
    initial: Tensor,
    push: Tensor | None = None,
    delays: Mapping[int, Tensor] | None = None,
    lanes: Mapping[str, slice] | None = None,
    differ: Mapping[str, Tensor] | None = None,
) -> Tensor:
    """Noise-free measurements (L, W, N, M) at the windows' own time stamps.

    Between two integration nodes, the state is the cubic with the values and derivatives at both. The derivative at
    the end of a step is the step's last stage, because a command can jump at the node.

    Args:
        system, windows, parameters, initial, push: As for :func:`trajectories`, with its source.
        delays: Channel -> (L,) lag [s] of its measurements behind their stamps. A sample within this lag after the
            window's start is extrapolated; leave such samples out of the windows. Where an effect of the system makes
            a channel late, windows begin at the state that this channel shows, and the simulation goes on beyond their
            end for the others.
        lanes, differ: As for :func:`integrate`.
    """
    delays = dict(delays or {})
    late = system.channel_delays(parameters)
    for c, ahead in ahead_of_latest(late, windows.t.shape[1]).items():
        delays[c] = delays.get(c, 0.0) - ahead.expand(initial.shape[0])
    whole = windows.prolonged(float(latest(late).max()))
    if push is not None:
        push = torch.nn.functional.pad(push, (0, whole.steps - windows.steps))
    nodes = integrate(system, whole, parameters, initial, push, lanes, differ)
    play = system.output_play(parameters)
    if any(width is not None for width in play):
        nodes = behind_play(nodes, play)
    slow = system.sensor_filter(parameters)
    nodes = nodes if not bool((slow > 0.0).any()) else filtered(nodes, slow, windows.step)
    count, channels, samples = len(windows), windows.t.shape[1], windows.t.shape[2]
    result = torch.empty(count, channels, samples, initial.shape[0], dtype=torch.float64)
    began = torch.from_numpy(windows.t0 - _log_starts(windows))[:, None, None]
    measured: Tensor | None = None
    stamped = 0  # channel at whose stamps `measured` is
    for c in range(channels):
        time = windows.t[:, c, :, None]
        if c in delays:
            late = time - delays[c]
            state = _between_each(nodes, late, windows.step)
            result[:, c] = system.measure_at(state, began + late, parameters)[..., c]
            continue
        if measured is None or not torch.equal(windows.t[:, c], windows.t[:, stamped]):
            stamped = c
            state = _between(nodes, windows.t[:, c], windows.step)
            measured = system.measure_at(state, began + time, parameters)
        result[:, c] = measured[..., c]
    return result.permute(3, 0, 1, 2)


def _log_starts(windows: Windows) -> np.ndarray:
    """(W,) first command of each window's log [s]."""
    return np.array([windows.commands[log].t[0] for log in windows.log])


def _between(nodes: Nodes, t: Tensor, h: float) -> Tensor:
    """Interpolate states by Hermite cubics at times t (W, M) [s] -> (W, M, L, S)."""
    steps, count = nodes.left[0].shape[:2]
    cell = (t / h).floor().long().clamp(0, steps - 1)
    s = (t / h - cell)[..., None]
    row = (cell * count + torch.arange(count)[:, None]).flatten()
    weights = _hermite(s, h)
    shape = (*t.shape, -1)
    parts = []
    for value, left, right in zip(*nodes, strict=True):
        flat = value.flatten(0, 1)
        pieces = (flat, left.flatten(0, 1), flat, right.flatten(0, 1))
        rows = (row, row, row + count, row)
        total = None
        for w, piece, at in zip(weights, pieces, rows, strict=True):
            picked = piece.index_select(0, at).view(shape)
            total = w * picked if total is None else total.addcmul_(w, picked)
        parts.append(total)
    return torch.stack(parts, -1)


def _between_each(nodes: Nodes, t: Tensor, h: float) -> Tensor:
    """As :func:`_between`, with separate times t (W, M, L) [s] for each lane."""
    steps, count, lanes = nodes.left[0].shape
    cell = (t / h).floor().long().clamp(0, steps - 1)
    s = t / h - cell
    window, lane = torch.arange(count)[:, None, None], torch.arange(lanes)[None, None, :]
    w0, w1, w2, w3 = _hermite(s, h)
    parts = []
    for value, left, right in zip(*nodes, strict=True):
        before, after = value[cell, window, lane], value[cell + 1, window, lane]
        parts.append(
            w0 * before + w1 * left[cell, window, lane] + w2 * after + w3 * right[cell, window, lane]
        )
    return torch.stack(parts, -1)


def _hermite(s: Tensor, h: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Weights of the value and slope at the start and of the value and slope at the end of a step."""
    r = 1.0 - s
    return r * r * (1.0 + 2.0 * s), h * s * r * r, s * s * (3.0 - 2.0 * s), -h * s * s * r
