"""What a fitted model leaves: whiteness, overdispersion, and the torque that is missing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.identify.dispersion import Dispersion, dispersion
from deepkoco.identify.fit import Fit, FitProblem
from deepkoco.identify.push import Push, push_torque
from deepkoco.identify.simulate import predict, trajectories
from deepkoco.identify.windows import Windows
from deepkoco.systems import ExtendedSystem

__all__ = [
    "Dispersion",
    "MissingTorque",
    "dispersion",
    "missing_torque",
    "push_of",
    "white_limit",
]

SLOTS = 20  # pieces of a window over each of which a missing torque is held constant
REACH = 1.5  # slots over which missing torques are alike: keeps the deconvolution from ringing


def white_limit(windows: Windows) -> float:
    """chi2 per sample above which residuals hold more than noise.

    Four standard deviations of chi2 / N, plus what is uncertain in the noise itself.
    """
    samples = windows.samples
    per_channel = [int(windows.valid[:, c].sum()) for c in range(windows.valid.shape[1])]
    noise = sum(
        (2.0 * n / samples * s.relative_sd) ** 2 for n, s in zip(per_channel, windows.noise, strict=True)
    )
    return 1.0 + 4.0 * math.sqrt(2.0 / samples + noise)


@dataclass(frozen=True)
class MissingTorque:
    """The outside torque that would make a model follow the measurements.

    Attributes:
        time: (W, K) middle of each slot, log time [s].
        log: (W,) log of each window.
        torque: (W, K) [N m].
        sd: (W, K) its standard deviation [N m].
        theta: (W, K) modelled angle there [rad].
        omega: (W, K) modelled speed there [rad/s].
        score: (W, K) fall of chi2 when a push is allowed in that slot alone.
        single: (W, K) the torque of that lone push [N m].
    """

    time: np.ndarray
    log: np.ndarray
    torque: np.ndarray
    sd: np.ndarray
    theta: np.ndarray
    omega: np.ndarray
    score: np.ndarray
    single: np.ndarray

    @property
    def slot(self) -> float:
        """Length of a slot [s]."""
        return float(self.time[0, 1] - self.time[0, 0])


def missing_torque(problem: FitProblem, fit: Fit, inflation: float = 1.0) -> MissingTorque:
    """Deconvolve the residuals of a fit into a torque that is constant over slots of the windows.

    The response of every window to a unit torque in every slot is simulated; the torques are the
    posterior mean under a smooth normal prior whose spread maximises the marginal likelihood.

    Args:
        problem: Windows.
        fit: Model whose residuals are explained.
        inflation: Factor by which the residuals' variance exceeds that of the sensors.
    """
    windows = problem.windows
    edges = np.linspace(0, windows.steps, SLOTS + 1).round().astype(int)
    unit = 1e-4 * problem.system.load_scale
    push = torch.zeros(SLOTS + 1, len(windows), windows.steps, dtype=torch.float64)
    for k in range(SLOTS):
        push[k + 1, :, edges[k] : edges[k + 1]] = unit
    states = fit.state.shape[1]
    lanes = fit.state[None].repeat(SLOTS + 1 + states, 1, 1)
    tiny = 1e-6
    for s in range(states):
        lanes[SLOTS + 1 + s, :, s] += tiny
    push = torch.cat([push, torch.zeros(states, *push.shape[1:], dtype=torch.float64)])
    theta = np.array([fit.values[n] for n in problem.names])
    base = ExtendedSystem(problem.system.base, tuple(e.name for e in problem.system.effects))
    named = {n: torch.tensor(v, dtype=torch.float64) for n, v in fit.values.items() if n not in Push.NAMES}
    zero = push_of(problem, theta)
    predicted = predict(base, windows, named, lanes, push if zero is None else push + zero)
    slope = ((predicted[1:] - predicted[0]) * problem.weight).reshape(SLOTS + states, len(windows), -1)
    response = (slope[:SLOTS] / unit).permute(1, 2, 0)  # (W, NM, K)
    own = (slope[SLOTS:] / tiny).permute(1, 2, 0)  # (W, NM, S)
    basis, _ = torch.linalg.qr(own)
    response = response - basis @ (basis.mT @ response)
    residual = fit.residual.reshape(len(windows), -1, 1)
    residual = residual - basis @ (basis.mT @ residual)
    energy = (response**2).sum(1)
    match = (response * residual).sum(1)
    distance = torch.arange(SLOTS, dtype=torch.float64)
    kernel = torch.exp(-0.5 * ((distance[:, None] - distance) / REACH) ** 2)
    torque, sd = _posterior(
        response / inflation**0.5,
        residual / inflation**0.5,
        torch.linalg.cholesky(kernel + 1e-6 * torch.eye(SLOTS)),
    )
    at = (edges[:-1] + edges[1:]) // 2
    path = _path(problem, base, named, fit.state)
    return MissingTorque(
        windows.t0[:, None] + windows.step * (edges[:-1] + edges[1:]) / 2.0,
        windows.log,
        torque,
        sd,
        path[at, :, 0].T,
        path[at, :, 1].T,
        (match**2 / energy.clamp_min(1e-300)).numpy(),
        (match / energy.clamp_min(1e-300)).numpy(),
    )


def push_of(problem: FitProblem, theta: np.ndarray) -> Tensor | None:
    """Torque (1, W, n) of the push in a parameter vector (P,), None if there is none."""
    return push_torque(problem.windows, theta[None, -len(Push.NAMES) :])


def _path(problem: FitProblem, system: ExtendedSystem, named: dict[str, Tensor], state: Tensor) -> np.ndarray:
    states, _, _ = trajectories(system, problem.windows, named, state[None])
    return states[:, 0].numpy()


def _posterior(response: Tensor, residual: Tensor, root: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean and standard deviation (W, K) under the spread of best marginal likelihood.

    Args:
        response: (W, NM, K) of the measurements to a unit torque in each slot.
        residual: (W, NM, 1).
        root: (K, K) square root of the prior's correlation between slots.
    """
    response = response @ root
    gram = response.mT @ response
    values, vectors = torch.linalg.eigh(gram)
    values = values.clamp_min(0.0)
    seen = (vectors.mT @ (response.mT @ residual))[..., 0]  # (W, K)
    scale = 1.0 / torch.sqrt(values.mean())
    best, spread = -math.inf, scale
    for exponent in np.linspace(-2.0, 3.0, 26):
        candidate = scale * 10.0**exponent
        inflated = 1.0 + candidate**2 * values
        evidence = float((candidate**2 * seen**2 / inflated - torch.log(inflated)).sum())
        if evidence > best:
            best, spread = evidence, candidate
    variance = spread**2 / (1.0 + spread**2 * values)
    mean = (root @ vectors @ (variance * seen)[..., None])[..., 0]
    covariance = ((root @ vectors) ** 2) @ variance[..., None]
    return mean.numpy(), torch.sqrt(covariance[..., 0]).numpy()
