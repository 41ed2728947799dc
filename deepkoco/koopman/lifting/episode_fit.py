"""EDMDc with settings that suit recorded episodes of any task: scaled features, a cost fitted to the recorded one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.koopman.lifting.edmdc import fit_edmdc, fit_lifted_cost
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel
from deepkoco.koopman.lifting.lifting import Array, ScaledRadialBasis

CENTRES = 20
COMPONENTS = 24
MOST_EPISODES = 150
COST_STEPS = 4000
RIDGE = 1e-3
SMALLEST_COST = 1e-9
LARGEST_PREDICTION = 1e12  # [cost]; of a model that diverges


def scaled_radial_basis(
    observations: Array, centres: int, generator: np.random.Generator
) -> ScaledRadialBasis:
    """Standardised observations with centres from the data.

    Of observations with many entries the leading principal components are taken, for the cost is fitted to all
    products of two lifted entries.

    Args:
        observations: (K, N).
        centres: How many; 0 for standardised observations alone.
        generator: Of their draw.
    """
    mean, spread = observations.mean(0), observations.std(0)
    scale = np.where(spread > 0, spread, 1.0)
    directions = np.diag(1.0 / scale)  # (N, entries)
    if len(scale) > COMPONENTS:
        _, vectors = np.linalg.eigh(np.cov((observations - mean) / scale, rowvar=False))
        directions = directions @ vectors[:, ::-1][:, :COMPONENTS]
    chosen = observations[generator.choice(len(observations), min(centres, len(observations)), replace=False)]
    return ScaledRadialBasis(mean, directions, (chosen - mean) @ directions)


def fit_to_episodes(
    observations: Sequence[Array],
    actions: Sequence[Array],
    costs: Sequence[Array],
    time_step: float,
    action_weight: float | Array,
    generator: np.random.Generator,
    centres: int = CENTRES,
    relative: float | None = None,
) -> LiftedLinearModel:
    """Fit EDMDc and its quadratic cost to recorded episodes.

    The dynamics are fitted to the first `MOST_EPISODES` episodes, the cost to `COST_STEPS` steps of all.

    Args:
        observations: Of each episode (L, N).
        actions: a_k (L, M) of each episode; they need exploration.
        costs: c_k (L,) of each episode.
        time_step: Seconds per step.
        action_weight: R, one for all actions or one each (M,).
        generator: Of centres and samples.
        centres: Thin-plate functions beside the observation itself.
        relative: Share of the mean cost from which on errors of the cost count relative to it; None: all alike.

    Returns:
        The model, ready for the planner.

    Raises:
        LiftedModelError: There are too few steps, or a number is not finite.
    """
    o, a, c = (np.concatenate(parts).astype(np.float64) for parts in (observations, actions, costs))
    lifting = scaled_radial_basis(o, centres, generator)
    chosen = np.arange(len(c))
    if chosen.size > COST_STEPS:
        chosen = np.sort(generator.choice(chosen, COST_STEPS, replace=False))
    above = None if relative is None else max(relative * float(c.mean()), SMALLEST_COST)
    cost = fit_lifted_cost(
        [o[chosen]], [a[chosen]], [c[chosen]], lifting, action_weight, relative_above=above
    )
    first = slice(MOST_EPISODES)
    return fit_edmdc(observations[first], actions[first], lifting, cost, time_step, RIDGE)


def fit_best_to_episodes(
    observations: Sequence[Array],
    actions: Sequence[Array],
    costs: Sequence[Array],
    time_step: float,
    action_weight: float | Array,
    horizon: int,
    generator: np.random.Generator,
    relative: float | None = None,
) -> LiftedLinearModel:
    """`fit_to_episodes` with or without thin-plate functions, whichever predicts held-out costs better.

    Functions that few centres spread over a wide range are worse than none near the goal of a nearly linear task: on a
    cart whose random episodes go 15 times as far as the task, the same planner costs 5 without and 16,000 with them.

    Args:
        observations: As for `fit_to_episodes`; every fourth episode is held out for the choice.
        actions: See there.
        costs: See there.
        time_step: See there.
        action_weight: See there.
        horizon: Most steps predicted in the choice.
        generator: See there.
        relative: See there.

    Returns:
        The model, fitted to all episodes.

    Raises:
        LiftedModelError: See there.
    """
    held = [i for i, c in enumerate(costs) if i % 4 == 3 and len(c) > 1]
    kept = [i for i in range(len(costs)) if i % 4 != 3]
    chosen = 0
    if held:
        errors, choices = [], (0, CENTRES)
        for centres in choices:
            o, a, c = ([part[i] for i in kept] for part in (observations, actions, costs))
            model = fit_to_episodes(o, a, c, time_step, action_weight, generator, centres, relative)
            errors.append(
                _root_error(model, [(observations[i], actions[i], costs[i]) for i in held], horizon)
            )
        # A model that diverges has an error of NaN or infinity and is not chosen; if all do, the plainest is.
        chosen = choices[int(np.nan_to_num(errors, nan=np.inf, posinf=np.inf).argmin())]
    return fit_to_episodes(
        observations, actions, costs, time_step, action_weight, generator, chosen, relative
    )


def _root_error(
    model: LiftedLinearModel, episodes: Sequence[tuple[Array, Array, Array]], horizon: int
) -> float:
    """Mean squared error of the roots of costs, so that costs far from the goal do not decide alone."""
    errors = []
    for o, a, c in episodes:
        steps = min(horizon, len(c) - 1)
        count = len(c) - steps
        z, a = model.lifting(np.asarray(o[:count], np.float64)), np.asarray(a, np.float64)
        for ahead in range(1, steps + 1):
            z = z @ model.transition.T + a[ahead - 1 : ahead - 1 + count] @ model.inputs.T
            predicted = np.minimum(model.cost(z, a[ahead : ahead + count]), LARGEST_PREDICTION)
            errors.append(np.square(np.sqrt(predicted) - np.sqrt(np.maximum(c[ahead : ahead + count], 0.0))))
    return float(np.concatenate(errors).mean())
