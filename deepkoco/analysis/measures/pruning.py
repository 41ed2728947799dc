"""What is lost when pairs are taken out of the cost, the least useful first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from deepkoco.analysis.measures.modes import Modes
from deepkoco.analysis.measures.rollout import Rollout
from deepkoco.analysis.measures.wrapped_model import WrappedModel
from deepkoco.koopman.latent_model import Array, LatentModel
from deepkoco.output.colours import COLOURS
from deepkoco.output.picture import Picture


@dataclass(frozen=True)
class PrunedModel(WrappedModel):
    """A latent model whose cost sees only some of the modes.

    Encoder and cost network still see everything: what is pruned is C, which becomes C times a projection.

    Attributes:
        projection: From `Modes.projection` (n, n).
    """

    projection: Array

    def linearise(self, observation: Array, action: Array) -> tuple[Array, Array]:
        """As of the whole model, with the pruned cost factor."""
        rows, factor = self.model.linearise(observation, action)
        return rows, np.ascontiguousarray(factor @ self.projection)

    def factor(self, latent: Array) -> Array:
        """The pruned cost factor (..., r, n)."""
        return np.ascontiguousarray(self.model.factor(latent) @ self.projection)


@dataclass(frozen=True)
class Pruning:
    """Errors with P, P - 1, .. 1, 0 pairs in the cost.

    Attributes:
        removed: Pairs in the order in which they were taken out (P,), counted from 0.
        errors: Root mean square error of the predicted cost with P - i pairs left (P + 1,) [cost].
        spread: Root mean square error of always predicting the mean cost [cost].
        closed_loop: By number of pairs kept, mean cost of an episode and its standard error; may be empty.
    """

    removed: NDArray[np.int64]
    errors: Array
    spread: float
    closed_loop: dict[int, tuple[float, float]]

    def kept(self, count: int) -> NDArray[np.bool_]:
        """Mask (P,) of the pairs that are left when ``count`` are."""
        mask = np.ones(self.removed.size, dtype=bool)
        mask[self.removed[: self.removed.size - count]] = False
        return mask


def prune(modes: Modes, rollout: Rollout, action_weight: float | Array) -> Pruning:
    """Take out one pair after the other, always the one whose loss raises the prediction error least.

    Args:
        modes: Of the model's dynamics.
        rollout: Predictions over the planning horizon.
        action_weight: R.

    Returns:
        The order and the errors; no closed loop yet.
    """
    horizon = rollout.latents.shape[1]
    split = modes.split_readout(
        np.broadcast_to(
            rollout.factors[:, None], (len(rollout.factors), horizon, *rollout.factors.shape[1:])
        ),
        rollout.latents,
    )[:, 1:]  # (W, H, r, P)
    split = split.reshape(-1, *split.shape[2:])
    action_cost = (action_weight * np.square(rollout.actions[:, 1:])).sum(-1).ravel()
    wanted = rollout.costs[:, 1:].ravel() - action_cost

    def error(readout: Array) -> float:
        return float(np.sqrt(np.square(wanted - np.square(readout).sum(-1)).mean()))

    readout = split.sum(-1)  # (K, r)
    left, removed, errors = list(range(split.shape[-1])), [], [error(readout)]
    while left:
        tried = [error(readout - split[..., pair]) for pair in left]
        best = int(np.argmin(tried))
        errors.append(tried[best])
        removed.append(left.pop(best))
        readout = readout - split[..., removed[-1]]
    spread = float(rollout.costs[:, 1:].std())
    return Pruning(np.array(removed), np.array(errors), spread, {})


def control_pruned(
    pruning: Pruning,
    model: LatentModel,
    modes: Modes,
    counts: Sequence[int],
    control: Callable[[LatentModel], Array],
) -> Pruning:
    """Add the closed-loop cost with some numbers of pairs.

    Args:
        pruning: From `prune`.
        model: The whole model.
        modes: Of its dynamics.
        counts: Numbers of pairs to keep.
        control: From a model to the costs of episodes under its planner (E,), from the same starts each time.

    Returns:
        The same with `closed_loop`.
    """
    found = {}
    for count in counts:
        costs = control(PrunedModel(model, model, modes.projection(pruning.kept(count))))
        found[count] = (
            float(costs.mean()),
            float(costs.std(ddof=1) / np.sqrt(costs.size)) if costs.size > 1 else 0.0,
        )
    return replace(pruning, closed_loop=found)


def draw_pruning(pruning: Pruning, horizon: int, episodes: int) -> Picture:
    """Both costs of pruning against the number of pairs kept."""
    pairs = pruning.removed.size
    kept = np.arange(pairs, -1, -1)
    cost = [pruning.closed_loop.get(int(k), (np.nan, np.nan)) for k in kept]
    table = pd.DataFrame(
        {
            "pairs_kept": kept,
            "removed_last": [np.nan, *(pruning.removed + 1)],
            "prediction_error": pruning.errors,
            "closed_loop_cost": [c for c, _ in cost],
            "closed_loop_standard_error": [e for _, e in cost],
        }
    )
    figure = Figure(figsize=(9.0, 3.4))
    left, right = figure.subplots(1, 2, sharex=True)
    left.plot(kept, pruning.errors, "o-", color=COLOURS["DeepKoCo"])
    left.axhline(
        pruning.spread, color=COLOURS["muted"], linestyle="--", label="always predicting the mean cost"
    )
    left.set(xlabel="pairs kept in the cost", ylabel=f"error of the predicted cost, 1 to {horizon} steps")
    left.set_ylim(bottom=0.0)
    left.legend()
    done = table.dropna(subset="closed_loop_cost")
    right.errorbar(
        done["pairs_kept"], done["closed_loop_cost"], 2 * done["closed_loop_standard_error"],
        fmt="o-", color=COLOURS["DeepKoCo"], capsize=3,
    )  # fmt: skip
    right.set(xlabel="pairs kept in the cost", ylabel=f"cost of an episode (mean of {episodes}, ± 2 s.e.)")
    right.set_ylim(bottom=0.0)
    caption = (
        "Pairs are taken out of the predicted cost one by one, always the one that is missed least; left, how wrong "
        "the predicted cost becomes, right, what an episode costs when the planner uses the pruned model. Where both "
        "curves are flat the model has more pairs than the task needs; encoder and networks stay as they are, so "
        "this says nothing about a smaller model trained anew."
    )
    return Picture("pruning", "How many pairs are needed?", caption, figure, table)
