"""Residuals of a fit: limits of whiteness and chi2, and the missing torque by deconvolution."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.diagnose.residuals.loaded import under_loads, with_steps_for
from deepkoco.diagnose.residuals.shifts import shifts_of_zero, steps_of_zero
from deepkoco.diagnose.residuals.waves import Waves
from deepkoco.fit.data.per_log_differences import effects_in
from deepkoco.fit.data.positions import positions_at
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.simulate.push import Push, push_torque
from deepkoco.fit.simulate.simulator import trajectories
from deepkoco.fit.solve.dispersion import Dispersion, dispersion
from deepkoco.systems import ExtendedSystem

__all__ = [
    "Dispersion",
    "MissingTorque",
    "coloured_from",
    "dispersion",
    "missing_torque",
    "push_of",
    "structured_from",
    "white_limit",
]

SLOTS = 20  # pieces of a window over each of which a missing torque is held constant
MAX_CORRELATION_SD = 5.0  # standard deviations of the correlation that white residuals have by chance
MAX_CHI2_SD = 4.0  # standard deviations of the chi2 that white residuals have by chance
SMOOTHING_SLOTS = 1.5  # correlation length of the missing torque; it keeps the deconvolution from ringing


def coloured_from(windows: Windows, deviations: float = MAX_CORRELATION_SD) -> float:
    """Return the correlation of neighbouring residuals from which they are not white.

    Args:
        windows: The windows.
        deviations: The limit in standard deviations of the correlation of white residuals.
    """
    return deviations / math.sqrt(windows.samples)


def structured_from(windows: Windows, chi2: float) -> float:
    """Return the correlation of neighbouring residuals from which a simulation as given lacks something.

    Noise of a sensor is white. What a simulation cannot follow is not: the rounding of a logged command is a force,
    which moves neighbouring samples alike, and so does the error of an integrator. The size of that part of the noise
    is known, and all of it may be alike in neighbours. A pattern that may be fitted to it is no explanation of it, so
    that is asked to leave white residuals (`coloured_from`).

    Args:
        windows: The windows.
        chi2: Mean squared residual in noise variances. Where it is more than noise, that part is a smaller share.
    """
    counts = windows.valid.sum((0, 2)).tolist()
    shares = [(n.simulated_sd / n.sd) ** 2 if n.simulated_sd > 0.0 else 0.0 for n in windows.noise]
    alike = sum(n * share for n, share in zip(counts, shares, strict=True)) / windows.samples
    return coloured_from(windows) + alike / max(chi2 / white_limit(windows), 1.0)


def white_limit(
    windows: Windows,
    correlation: float = 1.0,
    deviations: float = MAX_CHI2_SD,
    known: float = math.inf,
    apart: float = 0.0,
) -> float:
    """Return the chi2 per sample above which residuals contain more than noise.

    Args:
        windows: The windows.
        correlation: Samples per independent sample of the residuals of this unit when nothing is wrong, at least 1.
            The mean square of correlated residuals varies more: by sum(rho_k^2) as a variance (Bartlett), which is
            (c^2 + 1) / (2 c) where the autocorrelation rho_k falls by a constant share.
        deviations: The limit in standard deviations of chi2 per sample, including the uncertainty of the noise itself.
        known: Samples of healthy logs from which the noise was estimated, correlated alike; infinite where it is known.
        apart: Variance beside chance with which a further log differs from that estimate, as a share of its square. A
            model error depends on the motion, so one log leaves more of it than another.
    """
    samples = windows.samples
    per_channel = [int(windows.valid[:, c].sum()) for c in range(windows.valid.shape[1])]
    noise = sum(
        (2.0 * n / samples * s.relative_sd) ** 2 for n, s in zip(per_channel, windows.noise, strict=True)
    )
    chance = mean_square_variance(samples, correlation) + mean_square_variance(known, correlation)
    return 1.0 + deviations * math.sqrt(chance + apart + noise)


def mean_square_variance(samples: float, correlation: float) -> float:
    """Variance of the mean square of so many residuals, as a share of its square (Bartlett); see `white_limit`."""
    return (correlation**2 + 1.0) / correlation / samples


class SlotLoads(NamedTuple):
    """What small loads on J joints, in K slots of each of W windows, explain of the residuals.

    Attributes:
        curvature: (W, J, K, J, K) of half of chi2.
        slope: (W, J, K) of half of chi2, downwards.
        positions: (J, W, K) measured positions in the middle of the slots [rad or m].
    """

    curvature: np.ndarray
    slope: np.ndarray
    positions: np.ndarray


@dataclass(frozen=True)
class MissingTorque:
    """The outside load on one joint that would make a model follow the measurements.

    Attributes:
        joint: Which joint.
        unit: Unit of the load, N m or N; "torque" below stands for it.
        time: (W, K) middle of each slot, log time [s].
        log: (W,) log of each window.
        torque: (W, K) [N m].
        sd: (W, K) its standard deviation [N m].
        theta: (W, K) modelled angle in the slot [rad].
        omega: (W, K) modelled speed in the slot [rad/s].
        score: (W, K) fall of chi2 if a push acts in that slot alone.
        single: (W, K) torque of that single push [N m].
        name: Name of the joint.
        together: What loads on all joints explain; None where no body can be pushed.
        waves: What loads that repeat along the way explain; None where it is not asked.
        shifts: Parameters of the moves of its sensor's zero that lower chi2 most, the best first.
        steps: (W,) largest fall of chi2 by a step of that zero in each window alone.
    """

    joint: int
    unit: str
    time: np.ndarray
    log: np.ndarray
    torque: np.ndarray
    sd: np.ndarray
    theta: np.ndarray
    omega: np.ndarray
    score: np.ndarray
    single: np.ndarray
    name: str = ""
    together: SlotLoads | None = None
    waves: Waves | None = None
    shifts: tuple[dict[str, float], ...] = ()
    steps: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def load(self) -> str:
        """Kind of the load: "torque", or "force" for a sliding joint."""
        return "torque" if self.unit == "N m" else "force"

    @property
    def slot(self) -> float:
        """Length of a slot [s]."""
        return float(self.time[0, -1] - self.time[0, 0]) / (self.time.shape[1] - 1)


def missing_torque(problem: FitProblem, fit: Fit, inflation: float = 1.0) -> tuple[MissingTorque, ...]:
    """Deconvolve the residuals of a fit into missing loads on the joints, constant over slots of the windows.

    The response of every window to a unit load in every slot is simulated. The loads are the posterior mean under a
    smooth normal prior, whose standard deviation maximises the marginal likelihood.

    Args:
        problem: Windows.
        fit: Model whose residuals are deconvolved.
        inflation: Variance of the residuals over that of the sensor noise.

    Returns:
        The missing load of each joint.
    """
    exact, fit = problem.as_fitted(fit)
    problem = with_steps_for(exact, SLOTS)
    windows, system = problem.windows, problem.system
    joints, states = system.joints, fit.state.shape[1]
    edges = np.linspace(0, windows.steps, SLOTS + 1).round().astype(int)
    units = [1e-4 * scale for scale in system.load_scales]
    pulses = joints * SLOTS
    lanes = 1 + pulses + states
    push = torch.zeros(joints, lanes, len(windows), windows.steps, dtype=torch.float64)
    for j in range(joints):
        for k in range(SLOTS):
            push[j, 1 + j * SLOTS + k, :, edges[k] : edges[k + 1]] = units[j]
    initial = fit.state[None].repeat(lanes, 1, 1)
    tiny = 1e-6
    for s in range(states):
        initial[1 + pulses + s, :, s] += tiny
    theta = np.array([fit.values[n] for n in problem.names])
    named = {
        n: torch.tensor(fit.values[n], dtype=torch.float64) for n in problem.names if n not in Push.NAMES
    }
    base = acting_system(problem, fit)
    had = push_of(problem, theta)
    predicted = under_loads(problem, base, named, initial, push if had is None else push + had)
    slope = problem.weighed(predicted[1:] - predicted[0]).reshape(lanes - 1, len(windows), -1)
    # Where a load, or a change of the state, makes the simulation diverge, the window says nothing of it.
    slope = torch.where(torch.isfinite(slope).all(-1, keepdim=True), slope, 0.0)
    scale = torch.tensor(units, dtype=torch.float64).repeat_interleave(SLOTS)
    response = (slope[:pulses] / scale[:, None, None]).permute(1, 2, 0)  # (W, NM, J K)
    own = (slope[pulses:] / tiny).permute(1, 2, 0)  # (W, NM, S)
    basis, _ = torch.linalg.qr(own)
    response = response - basis @ (basis.mT @ response)
    residual = fit.residual.reshape(len(windows), -1, 1)
    residual = residual - basis @ (basis.mT @ residual)
    energy = (response**2).sum(1)
    match = (response * residual).sum(1)
    distance = torch.arange(SLOTS, dtype=torch.float64)
    kernel = torch.exp(-0.5 * ((distance[:, None] - distance) / SMOOTHING_SLOTS) ** 2)
    root = torch.linalg.cholesky(kernel + 1e-6 * torch.eye(SLOTS))
    torque, sd = _posterior(
        response / inflation**0.5,
        residual / inflation**0.5,
        torch.block_diag(*(root * scale for scale in system.load_scales)),
    )
    at = (edges[:-1] + edges[1:]) // 2
    whole = _path(exact, base, named, fit.state)
    path = whole[:: exact.windows.steps // windows.steps]
    together = None
    if system.push_places:
        count, shape = len(windows), (len(windows), joints, SLOTS)
        which, middle = np.repeat(np.arange(count), SLOTS), np.tile((edges[:-1] + edges[1:]) / 2.0, count)
        together = SlotLoads(
            (response.mT @ response).numpy().reshape(*shape, joints, SLOTS),
            match.numpy().reshape(shape),
            positions_at(windows, system, which, windows.step * middle).numpy().reshape(joints, count, SLOTS),
        )
    result = []
    for j in range(joints):
        mine = slice(j * SLOTS, (j + 1) * SLOTS)
        found = MissingTorque(
            j,
            system.load_units[j],
            windows.t0[:, None] + windows.step * (edges[:-1] + edges[1:]) / 2.0,
            windows.log,
            torque[:, mine],
            sd[:, mine],
            path[at, :, j].T,
            path[at, :, joints + j].T,
            (match**2 / energy.clamp_min(1e-300)).numpy()[:, mine],
            (match / energy.clamp_min(1e-300)).numpy()[:, mine],
            system.joint_names[j],
            together,
            Waves(exact, fit, base, j, whole[:, :, j]),
            shifts_of_zero(problem, j, residual, basis),
            steps_of_zero(problem, j, residual, basis),
        )
        result.append(found)
    return tuple(result)


def waves_of(problem: FitProblem, fit: Fit, joint: int) -> Waves:
    """Return what loads that repeat along the way of a joint do and explain at a fit."""
    problem, fit = problem.as_fitted(fit)
    path = modelled_path(problem, fit)[:, :, joint]
    return Waves(problem, fit, acting_system(problem, fit), joint, path)


def modelled_path(problem: FitProblem, fit: Fit) -> np.ndarray:
    """Return the simulated states (n + 1, W, S) of all windows, in the system's units; pushes are left out.

    Args:
        problem: W windows of n steps.
        fit: The model.
    """
    problem, fit = problem.as_fitted(fit)
    named = {
        n: torch.tensor(fit.values[n], dtype=torch.float64) for n in problem.names if n not in Push.NAMES
    }
    return _path(problem, acting_system(problem, fit), named, fit.state)


def acting_system(problem: FitProblem, fit: Fit) -> ExtendedSystem:
    """Return the base system with those effects whose fitted parameters differ from null."""
    full = ExtendedSystem(problem.system.base, tuple(e.name for e in problem.system.effects))
    null = {p.name: p.value for p in full.parameters}
    moved = {n.split(".")[0] for n in null if "." in n and fit.values[n] != null[n]}
    return ExtendedSystem(problem.system.base, tuple(moved | effects_in(problem.windows.known)))


def push_of(problem: FitProblem, theta: np.ndarray) -> Tensor | None:
    """Return the load (J, 1, W, n) of the push in a parameter vector (P,); None without a push."""
    return push_torque(problem.windows, theta[None, -len(Push.NAMES) :], problem.system)


def _path(problem: FitProblem, system: ExtendedSystem, named: dict[str, Tensor], state: Tensor) -> np.ndarray:
    states, _, _ = trajectories(system, problem.windows, named, state[None])
    return states[:, 0].numpy()


def _posterior(response: Tensor, residual: Tensor, root: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Return posterior mean and standard deviation (W, K) under the prior of highest marginal likelihood.

    Args:
        response: (W, NM, K) response of the measurements to a unit torque in each slot.
        residual: (W, NM, 1) residuals.
        root: (K, K) square root of the prior's correlation between slots.
    """
    response = response @ root
    gram = response.mT @ response
    values, vectors = torch.linalg.eigh(gram)
    values = values.clamp_min(0.0)
    seen = (vectors.mT @ (response.mT @ residual))[..., 0]  # (W, K)
    scale = 1.0 / torch.sqrt(values.mean().clamp_min(1e-300))
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
