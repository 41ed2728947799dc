"""The same planner on another model: EDMDc, a linear model with fixed features, fitted to episodes of the same kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.analysis.colours import COLOURS
from deepkoco.analysis.measures.steps import Steps
from deepkoco.koopman.latent_model import Array
from deepkoco.koopman.lifting.edmdc import fit_edmdc, fit_lifted_cost
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel
from deepkoco.koopman.lifting.lifting import RadialBasis
from deepkoco.output.picture import Picture

CENTRES = 20
COMPONENTS = 24
MOST_EPISODES = 150
COST_STEPS = 4000
RIDGE = 1e-3


class ReferenceCostError(ValueError):
    """A file of reference costs cannot be used."""


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


def fit_comparison(
    steps: Steps, time_step: float, action_weight: float, generator: np.random.Generator
) -> LiftedLinearModel:
    """Fit EDMDc and its quadratic cost to recorded episodes.

    Args:
        steps: With exploration, like the training's.
        time_step: Seconds per step.
        action_weight: R.
        generator: Of centres and samples.

    Returns:
        The model, ready for the planner.
    """
    lifting = ScaledRadialBasis(steps.observations, CENTRES, generator)
    cuts = steps.starts[1:]
    episodes = [np.split(array, cuts)[:MOST_EPISODES] for array in (steps.observations, steps.actions)]
    chosen = steps.sample(COST_STEPS, generator)
    cost = fit_lifted_cost(
        [steps.observations[chosen]], [steps.actions[chosen]], [steps.costs[chosen]], lifting, action_weight
    )
    return fit_edmdc(episodes[0], episodes[1], lifting, cost, time_step, RIDGE)


@dataclass(frozen=True)
class EpisodeCost:
    """Mean cost of episodes.

    Attributes:
        mean: [cost].
        standard_error: Of the mean [cost]; NaN where it is not known.
        episodes: How many; 0 where it is not known.
        same_starts: Whether the start states are those of the model's episodes.
    """

    mean: float
    standard_error: float
    episodes: int
    same_starts: bool


def episode_cost(costs: Array) -> EpisodeCost:
    """Mean and standard error of the costs of episodes (E,)."""
    error = float(costs.std(ddof=1) / np.sqrt(costs.size)) if costs.size > 1 else float("nan")
    return EpisodeCost(float(costs.mean()), error, costs.size, True)


def read_reference(path: Path) -> dict[str, EpisodeCost]:
    """Read reference costs from a CSV with the columns name, mean and, where known, standard_error and episodes.

    The table optimum.csv of `experiments.studies.learning.optimum` (method, input_delay, n, mean, ...) is one too.

    Args:
        path: The file.

    Returns:
        By name, in the file's order.

    Raises:
        ReferenceCostError: There is no such file, a column is missing, or a mean is no number.
    """
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise ReferenceCostError(f"{path}: not a CSV file of reference costs: {error}") from error
    table = table.rename(
        columns={"method": "name", "n": "episodes"}
    )  # as experiments.studies.learning.optimum writes them
    missing = [name for name in ("name", "mean") if name not in table]
    if missing:
        raise ReferenceCostError(
            f"{path}: column {', '.join(missing)} is missing; give name, mean[, standard_error]"
        )
    found = {}
    for row in table.to_dict("records"):
        try:
            mean, error = float(row["mean"]), float(row.get("standard_error", np.nan))
            episodes = row.get("episodes", 0)
            count = 0 if pd.isna(episodes) else int(episodes)
        except (TypeError, ValueError) as wrong:
            raise ReferenceCostError(f"{path}: row {row['name']!r} holds no number: {wrong}") from wrong
        if not np.isfinite(mean):
            raise ReferenceCostError(f"{path}: row {row['name']!r} has no finite mean")
        delayed = str(row.get("input_delay", False)) in ("True", "1")
        found[str(row["name"]) + (", one step of delay" if delayed else "")] = EpisodeCost(
            mean, error, count, False
        )
    return found


def draw_comparison(costs: Mapping[str, EpisodeCost], trained_on: str) -> Picture:
    """Bars of the mean cost of an episode, with their uncertainty.

    Args:
        costs: By name; names that are keys of `COLOURS` have their colour.
        trained_on: How EDMDc was fitted, for the caption.

    Returns:
        The picture.
    """
    table = pd.DataFrame([{"name": name, **vars(cost)} for name, cost in costs.items()])
    figure = Figure(figsize=(9.0, 1.1 + 0.5 * len(table)))
    axes = figure.subplots()
    place = np.arange(len(table))
    colours = [COLOURS.get(name.split(" ")[0], COLOURS["reference"]) for name in costs]
    axes.barh(place, table["mean"], color=colours, height=0.6)
    error = 2.0 * table["standard_error"].fillna(0.0)
    axes.errorbar(table["mean"], place, xerr=error, fmt="none", color=COLOURS["measured"], capsize=4)
    for i, cost in enumerate(costs.values()):
        axes.annotate(
            f"{cost.mean:.4g}",
            (cost.mean + error[i], i),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
        )
    axes.set_yticks(place, list(costs))
    axes.invert_yaxis()
    axes.set(xlabel="cost of an episode (mean, ± 2 standard errors)")
    axes.margins(x=0.12)
    axes.grid(axis="y", visible=False)
    caption = (
        "What an episode costs under different controllers; shorter is better. EDMDc + MPC is the same planner on a "
        f"linear model whose features are fixed beforehand instead of learned, {trained_on}; it also gets the chance "
        "to look three times as far ahead."
    )
    own = [name for name, cost in costs.items() if cost.same_starts]
    if len(own) < len(costs):
        caption += (
            " The other bars are reference values that were given to this command, from other start states."
        )
    else:
        caption += " No reference values (such as the optimum) were given to this command with --reference."
    return Picture("comparison", "How good is it?", caption, figure, table)
