"""Fits under errors that are correlated in time, as a force that a simulation lacks leaves them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit
from deepkoco.fit.shooting import ShootingProblem

HIGHEST_ORDER = 30  # of a filter
PER_ORDER = 10  # samples of a window that each order needs


class Whitening(NamedTuple):
    """Filter of one channel that leaves independent errors: e_k = sum_j a_j r_(k-j), with a_0 = 1.

    Attributes:
        coefficients: (p + 1,) a.
        sd: Standard deviation of e, in the channel's unit.
    """

    coefficients: np.ndarray
    sd: float


class ColouredProblem(FitProblem):
    """A fit of filtered measurements to filtered simulations.

    A force that a simulation lacks is integrated twice until a position shows it. Errors of a position are then large
    and slow, and neighbours are alike for a second: least squares that take them for independent judge a cause by the
    few slow errors, and do not see the accelerations that tell it from others. The filter of an autoregressive model
    makes errors independent, so each counts by what it tells (generalised least squares). The first samples of a
    window, of which the filter does not know the past, do not count.

    Source: Cochrane and Orcutt, Application of least squares regression to relationships containing auto-correlated
        error terms (1949).

    Args:
        problem: The problem with measurements as they are.
        filters: One of each channel.
    """

    def __init__(self, problem: FitProblem, filters: Sequence[Whitening]) -> None:
        self.__dict__.update(copy.copy(problem).__dict__)
        self._usual, self._uncut = None, False
        self.filters = tuple(filters)
        given = problem.windows
        known = given.valid.clone()
        for c, (coefficients, _) in enumerate(self.filters):
            for lag in range(1, len(coefficients)):
                known[:, c, lag:] &= given.valid[:, c, :-lag]
            known[:, c, : len(coefficients) - 1] = False
        sd = torch.tensor([f.sd for f in self.filters], dtype=torch.float64)[None, :, None]
        self.weight, self.whitening = known.to(torch.float64) / sd, None
        self.windows = given.with_value(self._filtered(given.value))

    def predict(self, theta: np.ndarray, initial: Tensor, nuisance: Tensor) -> Tensor:
        """Simulate filtered measurements (L, W, N, M); see :meth:`.ShootingProblem.predict`."""
        return self._filtered(ShootingProblem.predict(self, theta, initial, nuisance))

    @property
    def samples(self) -> int:
        """Number of filtered samples that count."""
        return int((self.weight > 0.0).sum())

    def _filtered(self, value: Tensor) -> Tensor:
        result = value.clone()
        for c, (coefficients, _) in enumerate(self.filters):
            for lag in range(1, len(coefficients)):
                result[..., c, lag:] += coefficients[lag] * value[..., c, :-lag]
        return result


def whitening(problem: FitProblem, fits: Sequence[Fit]) -> tuple[Whitening, ...]:
    """Return the filter of each channel that makes the residuals of some fits independent.

    Coefficients by Burg's method over all windows, the order by the BIC. Several fits share one filter.

    Source: Burg, Maximum entropy spectral analysis (1975).

    Args:
        problem: The problem that was fitted.
        fits: Its fits.
    """
    windows, result = problem.windows, []
    for c in range(windows.valid.shape[1]):
        inside = windows.valid[:, c].numpy()
        runs = []
        for fit in fits:
            error = windows.errors(fit.residual)[:, c].numpy()
            runs += [row[keep] for row, keep in zip(error, inside, strict=True)]
        shortest = min((len(run) for run in runs), default=0)
        result.append(_burg(runs, min(HIGHEST_ORDER, shortest // PER_ORDER)))
    return tuple(result)


def _burg(runs: Sequence[np.ndarray], highest: int) -> Whitening:
    """Return the filter of some runs of one process."""
    ahead, behind, a = list(runs), list(runs), np.ones(1)
    count = sum(len(run) for run in runs)
    power = sum(float(run @ run) for run in runs) / max(count, 1)
    best = Whitening(a, float(np.sqrt(max(power, 1e-300))))
    least = count * np.log(max(power, 1e-300))
    for order in range(1, highest + 1):
        ahead, behind = [run[1:] for run in ahead], [run[:-1] for run in behind]
        both = sum(float(x @ x + y @ y) for x, y in zip(ahead, behind, strict=True))
        if not both > 0.0:
            break
        mirrored = -2.0 * sum(float(x @ y) for x, y in zip(ahead, behind, strict=True)) / both
        ahead, behind = (
            [x + mirrored * y for x, y in zip(ahead, behind, strict=True)],
            [y + mirrored * x for x, y in zip(ahead, behind, strict=True)],
        )
        a = np.append(a, 0.0) + mirrored * np.append(a, 0.0)[::-1]
        left = sum(float(x @ x) for x in ahead) / sum(len(x) for x in ahead)
        cost = count * np.log(max(left, 1e-300)) + order * np.log(count)
        if cost < least:
            least, best = cost, Whitening(a, float(np.sqrt(max(left, 1e-300))))
    return best
