"""EDMDc with settings that suit recorded episodes of any task: scaled features, a cost fitted to the recorded one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.koopman.lifting.edmdc import fit_edmdc, fit_lifted_cost
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel
from deepkoco.koopman.lifting.lifting import Array, RadialBasis

CENTRES = 20
COMPONENTS = 24
MOST_EPISODES = 150
COST_STEPS = 4000
RIDGE = 1e-3


class ScaledRadialBasis:
    """Standardised observations and thin-plate functions of them; a `Lifting`.

    Without scaling, the entry with the largest unit would decide every distance. Of observations with many entries
    the leading principal components are taken, for the cost is fitted to all products of two lifted entries.
    """

    window = 1

    def __init__(self, observations: Array, centres: int, generator: np.random.Generator) -> None:
        """Take centres from the data.

        Args:
            observations: (K, N).
            centres: How many.
            generator: Of their draw.
        """
        self._mean, spread = observations.mean(0), observations.std(0)
        scale = np.where(spread > 0, spread, 1.0)
        self._directions = np.diag(1.0 / scale)  # (N, entries)
        if len(scale) > COMPONENTS:
            _, vectors = np.linalg.eigh(np.cov((observations - self._mean) / scale, rowvar=False))
            self._directions = self._directions @ vectors[:, ::-1][:, :COMPONENTS]
        chosen = observations[
            generator.choice(len(observations), min(centres, len(observations)), replace=False)
        ]
        self._basis = RadialBasis((chosen - self._mean) @ self._directions)

    @property
    def observation_size(self) -> int:
        """N."""
        return self._mean.size

    @property
    def size(self) -> int:
        """Entries of the lifted observation."""
        return self._basis.size

    def __call__(self, stacked: Array) -> Array:
        """Lift (..., N)."""
        return self._basis((stacked - self._mean) @ self._directions)


def fit_to_episodes(
    observations: Sequence[Array],
    actions: Sequence[Array],
    costs: Sequence[Array],
    time_step: float,
    action_weight: float,
    generator: np.random.Generator,
) -> LiftedLinearModel:
    """Fit EDMDc and its quadratic cost to recorded episodes.

    The dynamics are fitted to the first `MOST_EPISODES` episodes, the cost to `COST_STEPS` steps of all.

    Args:
        observations: Of each episode (L, N).
        actions: a_k (L, M) of each episode; they need exploration.
        costs: c_k (L,) of each episode.
        time_step: Seconds per step.
        action_weight: R.
        generator: Of centres and samples.

    Returns:
        The model, ready for the planner.

    Raises:
        LiftedModelError: There are too few steps, or a number is not finite.
    """
    o, a, c = (np.concatenate(parts).astype(np.float64) for parts in (observations, actions, costs))
    lifting = ScaledRadialBasis(o, CENTRES, generator)
    chosen = np.arange(len(c))
    if chosen.size > COST_STEPS:
        chosen = np.sort(generator.choice(chosen, COST_STEPS, replace=False))
    cost = fit_lifted_cost([o[chosen]], [a[chosen]], [c[chosen]], lifting, action_weight)
    first = slice(MOST_EPISODES)
    return fit_edmdc(observations[first], actions[first], lifting, cost, time_step, RIDGE)
