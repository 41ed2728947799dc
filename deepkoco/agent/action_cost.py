"""What a task charges for its actions, measured in episodes that noise moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.agent.buffer import Episode
from deepkoco.koopman.exported import Array

STEPS_PER_FEATURE = 5
STANDARD_ERRORS = 3.0
"""An R that is not as many standard errors above 0 counts as 0."""
COMPONENTS = 12
"""Principal components of the observation whose products explain costs."""
MOST_CONDITION = 1e6


def measure_action_cost(episodes: Sequence[Episode]) -> Array:
    r"""R of a cost $c(o, a) = g(o) + a^\top R a$ with any g, R diagonal.

    The action under which a step acts was decided one step earlier, from what came before plus noise that no
    observation has seen yet. So $v = a^2 - E[a^2 | past]$ has nothing to do with the observation, and
    $E[(c - a^\top R a) v] = 0$ gives R whatever g is. A least-squares fit to $a^2$ would take for a price of actions
    what they do to the state.

    Args:
        episodes: Moved by noise, with observations that are states.

    Returns:
        R (M,) [cost per squared action]; 0 where it is not clearly above 0.

    Source: the method of instrumental variables with errors by groups, here episodes (Wooldridge, Econometric Analysis
    of Cross Section and Panel Data, 2010, chapter 5).
    """
    nothing = np.zeros(episodes[0].actions.shape[1])
    parts = [_steps(episode) for episode in episodes if episode.costs.numel() > 2]
    parts = [part for part in parts if all(np.isfinite(array).all() for array in part)]
    if len(parts) < 2:
        return nothing
    o, a, c, before = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    past, seen = _products(before), _products(_components(o))
    if len(c) < STEPS_PER_FEATURE * max(past.shape[1], seen.shape[1]):
        return nothing
    # What observations explain has nothing to do with v; without it the estimate varies less.
    unexplained, squares = _residual(seen, c[:, None])[:, 0], _residual(seen, np.square(a))
    instrument = _residual(past, np.square(a))
    moments = instrument.T @ squares
    if not np.linalg.cond(moments) < MOST_CONDITION:
        return nothing
    found = np.linalg.solve(moments, instrument.T @ unexplained)
    left = instrument * (unexplained - squares @ found)[:, None]
    starts = np.cumsum([0, *(len(part[2]) for part in parts[:-1])])
    sums = np.add.reduceat(left, starts)  # of each episode (episodes, M)
    spread = np.linalg.solve(moments, sums.T)
    return np.where(found > STANDARD_ERRORS * np.sqrt(np.square(spread).sum(1)), found, 0.0)


def _steps(episode: Episode) -> tuple[Array, Array, Array, Array]:
    """Observation, action, cost and the two actions before, of every step that has them."""
    o, a, c = (getattr(episode, n).double().numpy() for n in ("observations", "actions", "costs"))
    return o[2:], a[2:], c[2:], np.hstack((a[1:-1], a[:-2]))


def _components(observations: Array) -> Array:
    """Standardised observations (K, N), or their leading principal components."""
    spread = observations.std(0)
    scaled = (observations - observations.mean(0)) / np.where(spread > 0.0, spread, 1.0)
    if scaled.shape[1] <= COMPONENTS:
        return scaled
    _, vectors = np.linalg.eigh(scaled.T @ scaled)
    return scaled @ vectors[:, ::-1][:, :COMPONENTS]


def _products(x: Array) -> Array:
    """1, the columns of x and all products of two of them."""
    first, second = np.triu_indices(x.shape[1])
    return np.hstack((np.ones((len(x), 1)), x, x[:, first] * x[:, second]))


def _residual(regressors: Array, targets: Array) -> Array:
    return targets - regressors @ np.linalg.lstsq(regressors, targets)[0]
