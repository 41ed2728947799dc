"""Extended dynamic mode decomposition with control: fit z' = A z + B a, and a cost, by least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deepkoco.koopman.lifting.lifted_linear import (
    LiftedCost,
    LiftedLinearModel,
    LiftedModelError,
    target_cost,
)
from deepkoco.koopman.lifting.lifting import Array, Lifting, stack_history

Episodes = Array | Sequence[Array]
MOST_COST_FEATURES = 50
"""Most lifted entries a cost is fitted to; the work grows with their fourth power."""


@dataclass(frozen=True)
class TargetCost:
    r"""The user's cost $(o - o^*)^\top Q (o - o^*) + R a^\top a$.

    Attributes:
        weights: Q (N, N) or its diagonal (N,).
        target: o* (N,).
        action_weight: R.
    """

    weights: ArrayLike
    target: ArrayLike
    action_weight: float


def fit_edmdc(
    observations: Episodes,
    actions: Episodes,
    lifting: Lifting,
    cost: TargetCost | LiftedCost,
    time_step: float,
    ridge: float = 0.0,
) -> LiftedLinearModel:
    r"""Fit A and B of $z_{k+1} = A z_k + B a_k$ with $z = g(o)$ to recorded episodes.

    $\min_{A, B} \sum |z_{k+1} - A z_k - B a_k|^2 + \rho |A, B|^2$; where the data leave directions open, the
    smallest matrices are taken.

    Args:
        observations: n episodes (n, T, N), or a sequence of (T_i, N).
        actions: a_k, applied from step k to k + 1 (n, T, M); each episode's last one is not used.
        lifting: g.
        cost: The user's cost on observations, or one fitted by `fit_lifted_cost`.
        time_step: Seconds per step.
        ridge: rho, 0 or more.

    Returns:
        A latent model for `deepkoco.planning.make_planner`.

    Raises:
        LiftedModelError: Episodes do not fit each other, or are too short for one pair of steps.

    Source: Korda and Mezic, Linear predictors for nonlinear dynamical systems, Automatica 93 (2018), Eq. 24-26.
    """
    episodes = _lifted_episodes(observations, actions, lifting)
    regressors = np.vstack([np.hstack((z[:-1], a[:-1])) for z, a, _ in episodes])
    targets = np.vstack([z[1:] for z, _, _ in episodes])
    if len(regressors) == 0:
        raise LiftedModelError("no episode has two steps; there is nothing to fit")
    matrices = _least_squares(regressors, targets, ridge).T
    if isinstance(cost, TargetCost):
        z, o = np.vstack([z for z, _, _ in episodes]), np.vstack([o for _, _, o in episodes])
        output = _least_squares(z, o, 0.0).T
        cost = target_cost(output, cost.weights, cost.target, cost.action_weight)
    return LiftedLinearModel(
        lifting, matrices[:, : lifting.size], matrices[:, lifting.size :], cost, time_step
    )


def fit_lifted_cost(
    observations: Episodes,
    actions: Episodes,
    costs: Episodes,
    lifting: Lifting,
    action_weight: float | Array,
    rank: int | None = None,
    iterations: int = 2000,
    relative_above: float | None = None,
) -> LiftedCost:
    r"""Fit a square of the lifted observation to recorded costs, for tasks whose cost is not known in form.

    $\min_{W \succeq 0} \sum w_k (c_k - a_k^\top R a_k - (z_k, 1)^\top W (z_k, 1))^2$, a convex program, by
    accelerated projected gradient on whitened features.

    Args:
        observations: As for `fit_edmdc`.
        actions: As for `fit_edmdc`.
        costs: c_k, which belong to (o_k, a_k) (n, T), or a sequence of (T_i,).
        lifting: g.
        action_weight: R, taken as known; one for all actions or one each (M,).
        rank: Rows to keep, the largest ones; None keeps all that matter.
        iterations: Steps of the gradient method.
        relative_above: Cost from which on errors count relative to it, $w_k = 1 / (e + |c_k|)$, so that few large
            costs do not decide what is cheap; None weighs all errors alike.

    Returns:
        The cost.

    Raises:
        LiftedModelError: Episodes do not fit each other.

    Source: Beck and Teboulle, A fast iterative shrinkage-thresholding algorithm (2009), with the projection
    on positive semidefinite matrices.
    """
    episodes = _lifted_episodes(observations, actions, lifting)
    z = np.vstack([z for z, _, _ in episodes])
    a = np.vstack([a for _, a, _ in episodes])
    c = np.concatenate([np.asarray(part, np.float64)[lifting.window - 1 :] for part in costs])
    if c.shape != (len(z),):
        raise LiftedModelError(f"{c.size} costs for {len(z)} steps; give one per observation")
    c = c - (action_weight * np.square(a)).sum(-1)
    x = np.hstack((z, np.ones((len(z), 1))))
    values, vectors = np.linalg.eigh(x.T @ x / len(x))
    kept = values > 1e-12 * values[-1]
    whiten = vectors[:, kept] / np.sqrt(values[kept])
    w = x @ whiten
    q = w.shape[1]
    if q > MOST_COST_FEATURES:
        raise LiftedModelError(
            f"{q} independent lifted entries; a cost is fitted to at most {MOST_COST_FEATURES}, "
            "give a smaller lifting or a TargetCost"
        )
    # A symmetric matrix is its upper triangle, off the diagonal times sqrt(2): the same length, a quarter of the work.
    upper, lower = np.triu_indices(q)
    double = np.where(upper == lower, 1.0, np.sqrt(2.0))
    gram, moment = np.zeros((len(upper), len(upper))), np.zeros(len(upper))
    roots = np.ones(len(c))
    if relative_above is not None:
        roots = (relative_above + np.abs(c)) ** -0.5
        roots /= np.sqrt(np.square(roots).mean())
    parts = len(w) // 1000 + 1
    for part, target, root in zip(
        *(np.array_split(array, parts) for array in (w, c * roots, roots)), strict=True
    ):
        outer = part[:, upper] * part[:, lower] * double * root[:, None]
        gram += outer.T @ outer / len(w)
        moment += outer.T @ target / len(w)
    step = 1.0 / np.linalg.eigvalsh(gram)[-1]
    full = np.zeros((q, q))
    present = ahead = np.zeros(len(upper))
    momentum = 1.0
    for _ in range(iterations):
        full[lower, upper] = (ahead - step * (gram @ ahead - moment)) / double
        values, vectors = np.linalg.eigh(full)
        projected = ((vectors * np.maximum(values, 0.0)) @ vectors.T)[upper, lower] * double
        following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum**2))
        ahead = projected + (momentum - 1.0) / following * (projected - present)
        present, momentum = projected, following
    full[lower, upper] = present / double
    values, vectors = np.linalg.eigh(full)
    order = np.argsort(values)[::-1]
    keep = [i for i in order if values[i] > 1e-9 * max(values[order[0]], 1e-300)][: rank or q]
    factor = (np.sqrt(values[keep])[:, None] * vectors[:, keep].T) @ whiten.T
    return LiftedCost(np.ascontiguousarray(factor[:, :-1]), factor[:, -1].copy(), action_weight)


def _lifted_episodes(
    observations: Episodes, actions: Episodes, lifting: Lifting
) -> list[tuple[Array, Array, Array]]:
    """z, a and o of every episode at the steps that have a whole window before them."""
    if len(observations) != len(actions):
        raise LiftedModelError(f"{len(observations)} episodes of observations, {len(actions)} of actions")
    episodes = []
    for i, (o, a) in enumerate(zip(observations, actions, strict=True)):
        o, a = np.asarray(o, np.float64), np.asarray(a, np.float64)
        if o.ndim != 2 or a.ndim != 2 or len(o) != len(a) or o.shape[1] != lifting.observation_size:
            raise LiftedModelError(
                f"episode {i} has observations {o.shape} and actions {a.shape}; "
                f"give (T, {lifting.observation_size}) and (T, M)"
            )
        first = lifting.window - 1
        episodes.append((lifting(stack_history(o, lifting.window)), a[first:], o[first:]))
    return episodes


def _least_squares(regressors: Array, targets: Array, ridge: float) -> Array:
    """Smallest X with regressors @ X = targets in the least-squares sense, with a penalty on its size."""
    if ridge > 0:
        size = regressors.shape[1]
        regressors = np.vstack((regressors, np.sqrt(ridge) * np.eye(size)))
        targets = np.vstack((targets, np.zeros((size, targets.shape[1]))))
    return np.asarray(np.linalg.lstsq(regressors, targets)[0], np.float64)
