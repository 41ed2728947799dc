"""Missing torque of a log, by differentiation of the positions, and simulations with a torque that is a function."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from scipy.signal import savgol_filter
from torch import Tensor

from deepkoco.fit.data.windows import Windows
from deepkoco.logs.recording import Recording
from deepkoco.systems import Motion, System
from experiments.studies.diagnosis.hidden_cause.questions import Simulate

SMOOTH = 0.07  # length of the polynomials that are differentiated [s]
STEP = 2e-3  # longest step of a simulation [s]
# Positions, speeds (..., J), efforts (..., M) -> torque (..., J)
Torque = Callable[[Tensor, Tensor, Tensor], Tensor]


class Missing(NamedTuple):
    """Samples of a log: positions, speeds, missing torque (n, J) [N m or N], commands (n, M)."""

    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    torque: np.ndarray


def missing_torque(system: System, logs: tuple[Recording, ...]) -> Missing:
    """Return the torque that the model as given lacks along logs: M (a - a_model), by Savitzky-Golay polynomials."""
    parts = [_of_log(system, log) for log in logs]
    return Missing(*(np.concatenate(x) for x in zip(*parts, strict=True)))


def _of_log(system: System, log: Recording) -> Missing:
    joints = system.joints
    places = [c.name for c, s in zip(system.measurements, system.measured_states, strict=True) if s < joints]
    first = log.channels[places[0]]
    gap = float(np.median(np.diff(first.t)))
    t = np.arange(first.t[0], first.t[-1], gap)
    length = max(2 * round(0.5 * SMOOTH / gap) + 1, 7)
    even = np.column_stack([np.interp(t, log.channels[n].t, log.channels[n].value) for n in places])
    q, v, a = (np.asarray(savgol_filter(even, length, 3, deriv=d, delta=gap, axis=0)) for d in (0, 1, 2))
    u = np.column_stack([log.channels[c.name].hold(t) for c in system.commands])
    parameters = system.default_parameters()
    angles, speeds, efforts = (torch.from_numpy(np.ascontiguousarray(x)).unbind(-1) for x in (q, v, u))
    motion = Motion(tuple(angles), tuple(speeds), tuple(efforts))
    modelled = torch.stack(torch.broadcast_tensors(*system.accelerations(parameters)(motion)), -1).numpy()
    rows = system.inverse_inertia(parameters)(motion)
    inverse = np.stack(
        [np.stack([np.broadcast_to(np.asarray(x), len(t)) for x in row], -1) for row in rows], -2
    )
    torque = np.linalg.solve(inverse, (a - modelled)[..., None])[..., 0]
    inside = slice(length, -length)
    return Missing(q[inside], v[inside], u[inside], torque[inside])


def simulation_with(system: System, torque: Torque) -> Simulate:
    """Return the simulation of a system with a torque beside it, by the classical Runge-Kutta method."""
    parameters = system.default_parameters()
    law, joints = system.accelerations(parameters), system.joints

    def slope(state: Tensor, effort: Tensor) -> Tensor:
        q, v = state[..., :joints], state[..., joints:]
        load = torque(q, v, effort)
        found = law(Motion(q.unbind(-1), v.unbind(-1), effort.unbind(-1), load.unbind(-1)))
        return torch.cat([v, torch.stack(torch.broadcast_tensors(*found), -1)], -1)

    def simulate(windows: Windows, starts: Tensor) -> Tensor:
        steps = max(int(np.ceil(windows.length / min(STEP, system.longest_step))), 1)
        h = windows.length / steps
        middle = windows.t0[:, None] + h * (np.arange(steps) + 0.5)
        held = np.stack([_held(windows, w, middle[w]) for w in range(len(windows))], 1)  # (n, W, M)
        efforts = torch.from_numpy(held)
        state, path, slopes = starts, [starts], []
        with torch.no_grad():
            for i in range(steps):
                effort = efforts[i].expand(*state.shape[:-1], -1)
                k1 = slope(state, effort)
                k2 = slope(state + 0.5 * h * k1, effort)
                k3 = slope(state + 0.5 * h * k2, effort)
                k4 = slope(state + h * k3, effort)
                slopes.append(k1)
                state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
                path.append(state)
        return _at_stamps(windows, torch.stack(path), torch.stack([*slopes, k4]), h)

    return simulate


def _held(windows: Windows, w: int, t: np.ndarray) -> np.ndarray:
    series = windows.commands[windows.log[w]]
    row = np.maximum(np.searchsorted(series.t, t + 1e-9, side="right") - 1, 0)
    return series.value[row].reshape(len(t), -1)


def _at_stamps(windows: Windows, path: Tensor, slopes: Tensor, h: float) -> Tensor:
    """Readings (L, W, N, M) by cubics between the nodes (n + 1, L, W, S)."""
    lanes, count = path.shape[1:3]
    result = torch.zeros(lanes, *windows.value.shape, dtype=torch.float64)
    across = torch.arange(count)[:, None]
    for c, s in enumerate(windows.shows):
        at = (windows.t[:, c] / h).clamp(0.0, len(path) - 1 - 1e-9)
        cell = at.floor().long()
        x = (at - cell)[..., None]
        pick = [y[..., s][cell + k, :, across] for y in (path, slopes) for k in (0, 1)]  # (W, M, L)
        a, b, da, db = pick
        r = 1.0 - x
        value = r * r * (1.0 + 2.0 * x) * a + x * x * (3.0 - 2.0 * x) * b + h * x * r * (r * da - x * db)
        result[:, :, c] = value.permute(2, 0, 1)
    return result
