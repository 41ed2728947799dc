"""Separation of causes: expected likelihood ratios to first order, for many sequences in one batch.

A log is simulated with cause a and fitted with cause b. Its chi2 exceeds that of noise on average by the
non-centrality. This is the squared length of the effect of a on the whitened measurements, after three projections:
of the free initial states, of the baseline's parameters within their prior, and of the effect of b. It is the
expected likelihood ratio against b.

Source: Atkinson and Fedorov, The design of experiments for discriminating between two rival models,
    Biometrika 62(1), 1975 (T-optimality), with nuisance parameters linearised.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.diagnose.experiment_design.doses import Dose
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import scaled_inverse
from deepkoco.fit.tangent import Tangent
from deepkoco.systems import ExtendedSystem

RIDGE = 1e-9  # relative; directions of one cause may be parallel
TINY = 1e-9  # length of a column [noise standard deviations] below which it has no effect
SMALL = 0.1  # share of a dose at which a smooth cause is linearised
# Causes whose small dose acts in another way than a large one, because it cuts only the largest commands.
CUTTING = ("saturation",)


@dataclass(frozen=True)
class Separation:
    """Expected likelihood ratios of K logs.

    Attributes:
        ratio: (K, C, C) ratio of a log of the first cause against the second cause; 0 on the diagonal.
        seen: (K, C) ratio against the refitted baseline alone.
        samples: (K,) number of measured values.
    """

    ratio: np.ndarray
    seen: np.ndarray
    samples: np.ndarray

    @property
    def strength(self) -> np.ndarray:
        """(K, C) ES: root mean square residual of the refitted baseline, in noise standard deviations."""
        return np.sqrt(self.seen / np.maximum(self.samples[:, None], 1))

    @property
    def smallest(self) -> np.ndarray:
        """(K,) ratio of the pair that is hardest to distinguish, in the harder direction."""
        if self.ratio.shape[1] == 1:
            return self.seen[:, 0]
        off = ~np.eye(self.ratio.shape[1], dtype=bool)
        return self.ratio[:, off].min(1)

    def worst(self, units: int) -> Separation:
        """Return the smallest numbers over units, where log u K + k is sequence k on unit u."""
        least = [x.reshape(units, -1, *x.shape[1:]).min(0) for x in (self.ratio, self.seen, self.samples)]
        return Separation(least[0], least[1], least[2])

    @property
    def share(self) -> np.ndarray:
        """(C, C) largest share of a cause's effect that another cause cannot imitate, over all logs; symmetric."""
        part = (self.ratio / np.maximum(self.seen[:, :, None], 1e-300)).max(0)
        return np.minimum(part, part.T)


def separate(
    system: ExtendedSystem,
    windows: Windows,
    values: Mapping[str, float],
    prior: Prior,
    doses: Sequence[Dose],
) -> Separation:
    """Expected likelihood ratios between causes on the windows of K logs.

    Args:
        system: The system with every effect.
        windows: Windows with states that belong to ``values``; their measurements are not used.
        values: Parameters of the baseline.
        prior: Prior over the baseline's free parameters.
        doses: C causes.
    """
    # A rival imitates a cause with a size of its own, so both are compared at small doses, where both are linear.
    parts = np.array([1.0 if d.cause.kind in CUTTING else SMALL for d in doses])
    doses = [d.scaled(part, system) for d, part in zip(doses, parts, strict=True)]
    problem = FitProblem(system, windows)
    logs, count = len(windows.commands), len(doses)
    if len(windows) == 0:
        return Separation(np.zeros((logs, count, count)), np.zeros((logs, count)), np.zeros(logs))
    nuisance, owner, moved = _columns(problem, values, prior.names, doses)
    gram = _gram(problem, torch.cat([nuisance, moved]))
    k = len(nuisance)
    precision = np.zeros((k, k))
    precision[: len(prior.names), : len(prior.names)] = prior.precision(prior.names)
    for i in range(len(prior.names), k):
        precision[i, i] = 1.0 / problem.zeros.sd[i - len(prior.names)] ** 2
    gram[:, :k, :k] += precision
    cleared = _without(gram, np.arange(k))[:, k:, k:]
    seen = np.stack([cleared[:, i, i] for i in owner.first], -1).clip(0.0)
    ratio = np.zeros((logs, count, count))
    for b in range(count):
        left = _without(cleared, owner.of(b))
        for a in range(count):
            if a != b:
                ratio[:, a, b] = left[:, owner.first[a], owner.first[a]]
    seen, ratio = seen / parts**2, ratio / parts[:, None] ** 2
    per_window = windows.valid.sum((1, 2)).numpy()
    samples = np.bincount(windows.log, per_window, minlength=logs)
    return Separation(np.minimum(ratio.clip(0.0), seen[:, :, None]), seen, samples)


@dataclass(frozen=True)
class _Owner:
    first: tuple[int, ...]
    total: int

    def of(self, index: int) -> np.ndarray:
        ends = (*self.first[1:], self.total)
        return np.arange(self.first[index], ends[index])


def _columns(
    problem: FitProblem, values: Mapping[str, float], free: Sequence[str], doses: Sequence[Dose]
) -> tuple[Tensor, _Owner, Tensor]:
    """Return whitened columns (., W, NM) with the initial states projected out: nuisances, then each dose's columns."""
    windows, names = problem.windows, problem.names
    theta = np.array([float(values[n]) for n in names])
    columns = np.array([names.index(n) for n in free], dtype=int)
    tangent = Tangent.at(problem, theta, columns, windows.state)
    directions = [dose.directions({n: float(values[n]) for n in names}, problem.system) for dose in doses]
    flat = [d for own in directions for d in own]
    fixed = len(tangent)
    dosed = np.array([[direction[n] for n in names] for direction in flat]).reshape(-1, len(names))
    lanes = np.concatenate([tangent.theta, dosed])
    states = torch.cat([tangent.state, windows.state[None].repeat(len(flat), 1, 1)])
    predicted = problem.predict(lanes, states, problem.zeros.none()[None].repeat(len(lanes), 1))
    change = problem.weighed(predicted - predicted[0]).flatten(2)
    basis, _ = torch.linalg.qr(change[1 + len(columns) : fixed].permute(1, 2, 0))
    own = change[1 : 1 + len(columns)] / tangent.steps[: len(columns), None, None]
    zeros = []
    for channel in problem.zeros.channels:
        column = torch.zeros_like(problem.weight)
        column[:, channel] = problem.weight[:, channel]
        zeros.append(problem.whitened(column).flatten(1)[None])
    parts, first, at = [], [], fixed
    for own_directions in directions:
        secant = change[at]
        first.append(sum(len(p) for p in parts))
        # Slopes at the dose: effect of a further change of each parameter.
        slopes = change[at + 1 : at + len(own_directions)] - secant
        size = slopes.flatten(1).norm(dim=1).clamp_min(1e-300)[:, None, None]
        parts.append(torch.cat([secant[None], slopes / size]))
        at += len(own_directions)
    moved = torch.cat(parts)
    everything = torch.cat([own, *zeros, moved])
    along = basis @ (basis.mT @ everything.permute(1, 2, 0))
    everything = everything - along.permute(2, 0, 1)
    nuisances = len(own) + len(zeros)
    return everything[:nuisances], _Owner(tuple(first), len(moved)), everything[nuisances:]


def _gram(problem: FitProblem, columns: Tensor) -> np.ndarray:
    """(K, C, C) inner products of columns (C, W, NM) over the windows of each log."""
    windows = problem.windows
    each = torch.einsum("cwm,dwm->wcd", columns, columns)
    gram = torch.zeros(len(windows.commands), *each.shape[1:], dtype=torch.float64)
    gram.index_add_(0, torch.from_numpy(windows.log), each)
    return gram.nan_to_num(0.0, 0.0, 0.0).numpy()


def _without(gram: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Inner products (K, C, C) after some of the columns are projected out."""
    if len(index) == 0:
        return gram
    inverse = scaled_inverse(gram[:, index][:, :, index], ridge=RIDGE, smallest=TINY)
    through = gram[:, :, index]
    return gram - through @ inverse @ through.transpose(0, 2, 1)


def smallest_pair(ratio: np.ndarray) -> float:
    """Smallest entry off the diagonal of (C, C)."""
    return float(ratio[~np.eye(len(ratio), dtype=bool)].min())
