"""One changed parameter that explains what a refit spread over many.

The prior of a model file is a guess: it allows a drive's gain to be 20 % off and a friction half. A refit under it
explains a motor of 0.7 of its gain by that gain, and then nothing is left for a cause. Whether the file is rough in
many of its values, or right but for one of them, is a question of weights. The refit has the data's information I about
all parameters, so each answer has its evidence in closed form: with the distance x from the values as given and
minus twice the log likelihood x'I x - 2 b'x,

    log p = b'(I + P^-1)^-1 b / 2 - log det(1 + I P) / 2.

P is the covariance of units of one make; that with one parameter as far off as its own size; or that of the guess.

Source: Kass, Raftery, Bayes factors (1995), the Laplace approximation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.causes.tolerance import usual_sd
from deepkoco.diagnose.data_sheet import guessed
from deepkoco.diagnose.nothing_at_once import ROUGH
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.prior import Prior
from deepkoco.systems import Parameter

ODDS = math.log(10.0)  # log odds against a rough file and against none, from which one change explains a log


def one_change(base: Refitted, fit: Fit) -> dict[str, float]:
    """Return how well each parameter explains a fit, changed alone, where better than a rough file does.

    Args:
        base: The refitted baseline.
        fit: Its refit, with causes or without.

    Returns:
        Name of the parameter -> log odds [nats] against a rough file and against units of one make; empty where
        nobody guessed a prior, healthy logs say what the unit is, or no single change is enough.
    """
    quadratic = _Quadratic.of(base, fit)
    if quadratic is None:
        return {}
    wide, usual = quadratic.wide, quadratic.usual
    rivals = max(quadratic.evidence(usual), quadratic.evidence(wide) + ROUGH) + ODDS
    found = {}
    for k, p in enumerate(quadratic.declared):
        if p.guessed:
            sds = usual.copy()
            sds[k] = max(wide[k], abs(p.value))
            found[p.name] = quadratic.evidence(sds) - math.log(len(usual)) - rivals
    return {name: weight for name, weight in found.items() if weight > 0.0}


def outweighs_rough_file(base: Refitted, with_cause: Fit, prior: Prior, choices: int) -> bool:
    """Return whether a cause beside units of one make explains logs better than a rough file, and than units alone.

    The cause and the rough file are compared where their own fits ended. What one fit says of the other by its slopes
    holds for small changes only: a body that is a quarter too heavy lies beyond, seen from a fit that has lightened
    everything else instead.

    Args:
        base: The refitted baseline, whose reference is the refit under the guessed prior.
        with_cause: Fit with the cause, where all else differs as between units of one make.
        prior: Prior of that fit.
        choices: Number of causes among which it was chosen.
    """
    quadratic = _Quadratic.of(base, base.reference)
    if quadratic is None:
        return False
    rows = [prior.names.index(n) for n in with_cause.free]
    covariance = prior.covariance[np.ix_(rows, rows)]
    sign, size = np.linalg.slogdet(
        np.eye(len(rows)) + covariance @ with_cause.information / quadratic.deflation
    )
    if sign <= 0.0:
        return False
    found = -0.5 * (with_cause.chi2 / quadratic.deflation + with_cause.penalty) - 0.5 * float(size)
    rivals = max(quadratic.evidence(quadratic.usual), quadratic.evidence(quadratic.wide) + ROUGH) + ODDS
    return found - math.log(max(choices, 1)) > rivals - 0.5 * quadratic.constant


class _Quadratic(NamedTuple):
    """Minus twice the log likelihood near a fit, x'I x - 2 b'x + c with the distance x from the values as given.

    Attributes:
        declared: The n parameters; each array counts in their units.
        data: (n, n) information I.
        pull: (n,) slope b.
        constant: c.
        wide: (n,) standard deviations of the guess. It keeps a parameter of each scale that the log leaves open; here
            the other priors settle it.
        usual: (n,) standard deviations of units of one make.
        deflation: By which information, slope and constant are divided.
    """

    declared: list[Parameter]
    data: np.ndarray
    pull: np.ndarray
    constant: float
    wide: np.ndarray
    usual: np.ndarray
    deflation: float

    @staticmethod
    def of(base: Refitted, fit: Fit) -> _Quadratic | None:
        """That of a refit; None where nobody guessed a prior, or healthy logs say what the unit is."""
        start = base.start
        if base.learned.healthy is not None or start.tempering > 1.0 or not guessed(start):
            return None
        names = [n for n in start.prior.names if n in fit.free and "." not in n]
        rows, own = [fit.free.index(n) for n in names], [start.prior.names.index(n) for n in names]
        guess = start.prior.covariance[np.ix_(own, own)]
        if not (guess.diagonal() > 0.0).all():
            return None
        deflation = max(dispersion(fit, base.train).deflation, start.least_deflation)
        data = fit.information[np.ix_(rows, rows)]
        away = np.array([fit.values[n] for n in names]) - start.prior.centre[own]
        # The slope of the data's cost balances that of the prior at the fit.
        pull = (data @ away + np.linalg.solve(guess, away)) / deflation
        data = data / deflation
        declared = [start.system.parameter(n) for n in names]
        wide = np.array([p.prior_sd for p in declared])
        usual = np.array([usual_sd(p) if p.guessed else sd for p, sd in zip(declared, wide, strict=True)])
        if not (np.isfinite(data).all() and np.isfinite(pull).all() and (usual > 0.0).all()):
            return None
        constant = float(fit.chi2 / deflation - away @ data @ away + 2.0 * pull @ away)
        return _Quadratic(declared, data, pull, constant, wide, usual, deflation)

    def evidence(self, sds: np.ndarray) -> float:
        """Log evidence of a prior with these standard deviations, beside ``constant``."""
        return _evidence(self.data, self.pull, sds)


def _evidence(data: np.ndarray, pull: np.ndarray, sds: np.ndarray) -> float:
    """Log evidence of a prior with these standard deviations, up to a constant."""
    scaled = np.eye(len(sds)) + sds[:, None] * data * sds
    sign, size = np.linalg.slogdet(scaled)
    if sign <= 0.0:
        return -math.inf
    own = sds * pull
    return 0.5 * float(own @ np.linalg.solve(scaled, own)) - 0.5 * float(size)
