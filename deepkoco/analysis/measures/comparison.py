"""The same planner on another model: EDMDc, a linear model with fixed features, fitted to episodes of the same kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.analysis.measures.steps import Steps
from deepkoco.koopman.latent_model import Array
from deepkoco.koopman.lifting.episode_fit import fit_to_episodes
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel
from deepkoco.output.colours import COLOURS
from deepkoco.output.picture import Picture


class ReferenceCostError(ValueError):
    """A file of reference costs cannot be used."""


def fit_comparison(
    steps: Steps, time_step: float, action_weight: float | Array, generator: np.random.Generator
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
    observations, actions, costs = (
        np.split(array, steps.starts[1:]) for array in (steps.observations, steps.actions, steps.costs)
    )
    return fit_to_episodes(observations, actions, costs, time_step, action_weight, generator)


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
