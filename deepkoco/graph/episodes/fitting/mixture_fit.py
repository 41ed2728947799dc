"""Mixtures fitted by expectation maximisation, their family and size chosen by BIC."""

import math
from dataclasses import dataclass

import numpy as np

from deepkoco.graph.delay import Delay, Deterministic, Gaussian, LogNormal, Mixture

_GROUPS = 512  # neighbours in rank are one weighted sample: the steps cost the same for long recordings
_STEPS = 300
_PATIENCE = 2  # sizes that are tried beyond the best so far
_CONSTANT = 1e-9  # range of a constant delay [s]: differences of stamps round
_NARROWEST = 0.02  # standard deviation of a component, as a part of that between the quartiles


@dataclass(frozen=True)
class NormalMixture:
    """Weights, means and standard deviations (K,) of a mixture of normals, and its BIC in the data's units."""

    weights: np.ndarray
    means: np.ndarray
    deviations: np.ndarray
    bic: float


def fit_mixture(samples: np.ndarray, most: int = 8) -> Delay:
    """Fit mixtures of truncated Gaussians and of log-normals with up to `most` components; return the best.

    The best has the lowest Bayesian information criterion, -2 log L + (3 K - 1) log n.

    Args:
        samples: (n,) delays [s].
        most: largest number of components K.
    """
    samples = np.sort(np.asarray(samples, dtype=np.float64))
    if samples[-1] - samples[0] <= _CONSTANT:
        return Deterministic(float(np.median(samples)))
    found = [(fit.bic, 0, fit) for fit in _fits(samples, most, 0.0)]
    if samples[0] > 0:
        # The density of x is that of log x over x.
        jacobian = 2.0 * float(np.log(samples).sum())
        found += [(fit.bic, 1, fit) for fit in _fits(np.log(samples), most, jacobian)]
    _, family, best = min(found, key=lambda item: (item[0], item[1], len(item[2].weights)))
    order = np.argsort(best.means)
    components = []
    for mean, deviation in zip(best.means[order].tolist(), best.deviations[order].tolist(), strict=True):
        if family == 0:
            components.append(Gaussian(max(mean, 0.0), deviation))
        else:
            components.append(LogNormal(math.exp(mean), deviation))
    return components[0] if len(components) == 1 else Mixture(tuple(components), tuple(best.weights[order]))


def _fits(values: np.ndarray, most: int, jacobian: float) -> list[NormalMixture]:
    points = np.array([group.mean() for group in np.array_split(values, min(_GROUPS, len(values)))])
    mass = np.array([len(group) for group in np.array_split(values, min(_GROUPS, len(values)))], dtype=float)
    fits = []
    for size in range(1, min(most, len(values) // 10 or 1) + 1):
        weights, means, deviations = expectation_maximisation(points, mass, size)
        density = np.exp(_log_parts(values, weights, means, deviations)).sum(axis=1)
        likelihood = float(np.log(np.maximum(density, 1e-300)).sum())
        bic = -2.0 * likelihood + jacobian + (3 * size - 1) * math.log(len(values))
        fits.append(NormalMixture(weights, means, deviations, bic))
        if size - 1 - int(np.argmin([fit.bic for fit in fits])) >= _PATIENCE:
            break
    return fits


def expectation_maximisation(
    points: np.ndarray, mass: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit `size` normals to sorted points (n,) with masses (n,); start from equal parts of the mass.

    Source: Dempster, Laird and Rubin (1977).
    """
    parts = np.array_split(np.arange(len(points)), size)
    quartiles = np.interp([0.25, 0.75], (np.cumsum(mass) - 0.5 * mass) / mass.sum(), points)
    floor = _NARROWEST * max(float(quartiles[1] - quartiles[0]), 1e-3 * float(np.ptp(points)))
    means = np.array([np.average(points[p], weights=mass[p]) for p in parts])
    deviations = np.array([max(float(points[p].std()), floor) for p in parts])
    weights = np.array([mass[p].sum() for p in parts]) / mass.sum()
    last = -np.inf
    for _ in range(_STEPS):
        logs = _log_parts(points, weights, means, deviations)
        top = logs.max(axis=1, keepdims=True)
        shares = np.exp(logs - top)
        total = shares.sum(axis=1, keepdims=True)
        likelihood = float((mass * (np.log(total) + top)[:, 0]).sum())
        shares *= mass[:, None] / total
        held = shares.sum(axis=0) + 1e-12
        weights = held / held.sum()
        means = shares.T @ points / held
        spread = np.maximum(shares.T @ points**2 / held - means**2, 0.0)
        deviations = np.maximum(np.sqrt(spread), floor)
        if likelihood - last < 1e-7 * abs(likelihood):
            break
        last = likelihood
    return weights, means, deviations


def _log_parts(
    values: np.ndarray, weights: np.ndarray, means: np.ndarray, deviations: np.ndarray
) -> np.ndarray:
    score = (values[:, None] - means) / deviations
    return np.log(weights) - np.log(deviations) - 0.5 * score**2 - 0.5 * math.log(2.0 * math.pi)
