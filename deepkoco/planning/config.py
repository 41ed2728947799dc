"""Settings and limits of the linear model-predictive controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass
class PlannerConfig:
    """Settings of the LMPC."""

    horizon: int = 13
    """H, planned steps; a little less than the training horizon T, see docs/training.md."""
    increment_weight: float = 0.01
    """R~, weight of a squared action increment."""
    form: str = "condensed"
    """How the problem is written: "condensed" (actions only) or "sparse" (latents too)."""
    solver: str = "daqp"
    """Backend of the condensed form: "daqp", "osqp" or any other installed solver of qpsolvers."""
    tolerance: float = 1e-6
    """Absolute and relative tolerance of the OSQP backends."""


@dataclass(frozen=True)
class PlanningProblem:
    """What stays fixed in a control loop: the dynamics' eigenvalues, weights and limits.

    Attributes:
        eigenvalues: Discrete-time eigenvalues (P,), complex.
        action_low: a_min (M,).
        action_high: a_max (M,).
        action_weight: R.
        increment_weight: R~.
        horizon: H.
    """

    eigenvalues: NDArray[np.complex128]
    action_low: Array
    action_high: Array
    action_weight: float
    increment_weight: float
    horizon: int


class SolverError(RuntimeError):
    """A quadratic program was not solved."""
