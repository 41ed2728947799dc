"""Input and result of one fit: `Trial` and `Fit`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from torch import Tensor

from deepkoco.fit.solve.prior import Prior

# Relative additions to the diagonals of the normal equations: of a first step, and the largest that a fit hands on to
# another one, which soon steps farther than this where slopes hold.
FIRST_DAMPING, MOST_DAMPING = 1e-4, 0.1
STUCK = 0.01  # share of its cost that a step still promises where a fit is stuck


@dataclass(frozen=True)
class Trial:
    """Input of one fit.

    Attributes:
        name: Name of the trial.
        free: Names of the parameters to fit, push parameters included.
        prior: Prior over (at least) the free parameters.
        values: Start values of all parameters; those that are not free are fixed.
        state: (W, S) start values of the initial states; None takes the windows' first guess.
        nuisance: (z,) start values of the nuisances of the logs (:class:`.nuisances.Nuisances`); None for zeros.
        renew: Free parameters whose slopes are computed at every point, also where a fit keeps the other slopes.
        damping: Of the first step, relative to the diagonals of the normal equations.
    """

    name: str
    free: tuple[str, ...]
    prior: Prior
    values: Mapping[str, float]
    state: Tensor | None = None
    nuisance: Tensor | None = None
    renew: tuple[str, ...] = ()
    damping: float = FIRST_DAMPING

    def from_fit(self, fit: Fit) -> Trial:
        """Return this trial with another start: the values, initial states, nuisances and damping of a fit."""
        return replace(self, values=fit.values, state=fit.state, nuisance=fit.nuisance, damping=fit.damping)


@dataclass
class Fit:
    """Result of one trial.

    Attributes:
        name: Name of the trial.
        free: Names of the freed parameters.
        values: Values of all parameters after the fit.
        covariance: (p, p) posterior covariance of the free parameters under the assumed noise.
        information: (p, p) information of the data without priors; initial states and nuisances are eliminated.
        state: (W, S) initial states.
        nuisance: (z,) nuisances of the logs: encoder zeros [rad], then differences of parameters from their mean.
        chi2: Sum of squared residuals in noise standard deviations; infinite if the simulation diverged.
        penalty: Prior's share of the cost.
        residual: (W, N, M) measured minus predicted, in noise standard deviations, 0 where padded.
        curvature: (p + z, p + z) curvature of the cost in the free parameters and the z nuisances, priors included.
        history: Cost after every iteration.
        converged: Whether the last step was below the tolerance.
        exact: Whether covariance, information and curvature belong to these values, not to an earlier point of the fit.
        narrowed: Factor by which its prior is narrower, as a variance, than that of the other fits.
        promised: Fall of the cost that a step without damping promises where the fit has ended.
        damping: With which a fit that begins here starts: where a joint sticks and slips, slopes hold over short steps
            only, and a fit that begins beside another need not find that out again.
    """

    name: str
    free: tuple[str, ...]
    values: dict[str, float]
    covariance: np.ndarray
    information: np.ndarray
    state: Tensor
    nuisance: Tensor
    chi2: float
    penalty: float
    residual: Tensor
    curvature: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    history: list[float] = field(default_factory=list)
    converged: bool = False
    exact: bool = True
    narrowed: float = 1.0
    promised: float = 0.0
    damping: float = FIRST_DAMPING

    @property
    def diverged(self) -> bool:
        """Whether the simulation diverged at the start values; nothing was fitted, the values are the start values."""
        return not math.isfinite(self.chi2)

    @property
    def cost(self) -> float:
        """chi2 plus prior penalty: minus twice the log posterior up to a constant."""
        return self.chi2 + self.penalty

    @property
    def stuck(self) -> bool:
        """Whether it ended without a minimum: a step still promises much, but none that was tried keeps it.

        Stick and slip can make a motion so sensitive that slopes hold over a tiny step only.
        """
        return self.promised > STUCK * self.cost
