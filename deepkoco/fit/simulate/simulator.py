"""Simulate all windows for all lanes in one batch. A lane is one set of parameters and initial states."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.per_log_differences import amounts, of_windows
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.simulate.bytecode.along_windows import along_windows, has_program
from deepkoco.fit.simulate.command_effort import Efforts, command_efforts
from deepkoco.fit.simulate.equations import equations_of, friction_of
from deepkoco.fit.simulate.interpolation import states_at
from deepkoco.fit.simulate.nodes import Nodes
from deepkoco.fit.simulate.play import behind_play
from deepkoco.fit.simulate.sensor_filter import filtered
from deepkoco.fit.simulate.torch_steps import StepsInput, in_torch
from deepkoco.systems import System
from deepkoco.systems.channel_delay import ahead_of_latest, latest
from deepkoco.systems.rollout import RolloutInput

UNEVEN = 10.0  # factor on the unevenness of a step's pieces from which their jumps bend its speeds in full


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

    Source: classical Runge-Kutta with an effort that is linear in time within the step, or each of its pieces.
    """
    nodes = integrate(system, windows, parameters, initial, push)
    states, left, right = (torch.stack(part, -1).transpose(1, 2) for part in nodes)
    return states, left, right


def is_compiled(system: System, step: float) -> bool:
    """Whether a compiled loop or bytecode takes the steps [s] of a system without effects; else torch does."""
    values = system.default_parameters()
    if system.rollout(values) is not None:
        return True
    # Steps that are cut where commands jump have a program of their own.
    rubs = system.own_step is None and bool(system.dry_friction_levels(values).joints)
    return has_program(system, step) and (not rubs or has_program(system, None))


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
    friction = friction_of(system, own, lanes)
    at_jumps = bool(friction.joints) and system.own_step is None and not windows.own_steps
    efforts = command_efforts(system, windows, parameters, count, apart, at_jumps)
    pushes = None if push is None else push.permute(3, 0, 2, 1).contiguous()  # (n, J, W, L)
    parts = initial.permute(2, 1, 0).contiguous().unbind(0)
    t0 = torch.from_numpy(windows.t0)[:, None]
    compiled = system.rollout(own)
    if compiled is not None:
        loads = None if push is None else push.permute(0, 3, 2, 1)
        given = RolloutInput(
            h, parts, t0, efforts.begin, efforts.slope, loads, friction, efforts.length, efforts.pieces
        )
        if (found := compiled.run(given)) is not None:
            fast = found.value[joints:]
            nodes = Nodes(
                found.value, (*(v[:-1] for v in fast), *found.first), (*(v[1:] for v in fast), *found.last)
            )
            return _between_jumps(nodes, efforts, h)
    way = None if windows.way is None else windows.way.permute(2, 1, 0)[..., None]
    given = StepsInput(
        h, parts, t0, efforts.begin, efforts.slope, pushes, bool(apart), way, windows.unseen, efforts.length,
        efforts.pieces,
    )  # fmt: skip
    if (fast := along_windows(system, own, lanes, given)) is not None:
        return _between_jumps(fast, efforts, h)
    return _between_jumps(in_torch(equations_of(system, own, lanes), given), efforts, h)


def _between_jumps(nodes: Nodes, efforts: Efforts, h: float) -> Nodes:
    """Return nodes between which the speeds in steps that are cut add up to the ways of these steps.

    The accelerations at both ends of a step are the means over its pieces, by their lengths. A speed that is a cubic
    with them goes nearly the way of a step with one long piece, but not that of a step with a jump in its middle.
    """
    if efforts.length is None:
        return nodes
    share = (efforts.length / h).unflatten(0, (-1, efforts.pieces))
    cut = (UNEVEN * (1.0 - share.square().sum(1))).clamp(0.0, 1.0)
    joints = len(nodes.value) // 2
    left, right = list(nodes.left), list(nodes.right)
    for j in range(joints):
        angle, speed = nodes.value[j], nodes.value[joints + j]
        first, last = left[joints + j], right[joints + j]
        missing = (angle[1:] - angle[:-1]) / h - 0.5 * (speed[1:] + speed[:-1]) - h / 12.0 * (first - last)
        bend = cut * (6.0 / h) * missing
        left[joints + j], right[joints + j] = first + bend, last - bend
    return Nodes(nodes.value, tuple(left), tuple(right))


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
    began = torch.from_numpy(windows.t0 - _log_starts(windows))[:, None, None]
    if not delays and bool((windows.t == windows.t[:, :1]).all()):
        time = windows.t[:, 0]
        state = states_at(nodes, time, windows.step)
        measured = system.measure_at(state, began + time[..., None], parameters)
        return measured.permute(2, 0, 3, 1).contiguous()
    result = torch.empty(initial.shape[0], count, channels, samples, dtype=torch.float64)
    for own in _at_the_same_times(windows.t, delays):
        time, lag = windows.t[:, own[0], :, None], delays.get(own[0])
        if lag is None:
            state = states_at(nodes, windows.t[:, own[0]], windows.step)
        else:
            time = time - lag
            state = states_at(nodes, time.expand(-1, -1, initial.shape[0]), windows.step)
        measured = system.measure_at(state, began + time, parameters)
        for c in own:
            result[:, :, c] = measured[..., c].permute(2, 0, 1)
    return result


def _at_the_same_times(t: Tensor, delays: Mapping[int, Tensor]) -> list[list[int]]:
    """Group channels that show states at the same times.

    Args:
        t: (W, N, M) time stamps.
        delays: Channel -> (L,) lag behind its stamps.
    """
    groups: list[list[int]] = []
    for c in range(t.shape[1]):
        for group in groups:
            first, own = delays.get(group[0]), delays.get(c)
            alike = first is own if first is None or own is None else torch.equal(first, own)
            if alike and torch.equal(t[:, group[0]], t[:, c]):
                group.append(c)
                break
        else:
            groups.append([c])
    return groups


def _log_starts(windows: Windows) -> np.ndarray:
    """(W,) first command of each window's log [s]."""
    return np.array([windows.commands[log].t[0] for log in windows.log])
