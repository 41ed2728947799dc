"""How far ahead the predictions hold: errors of latents and costs against the horizon."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deepkoco.analysis.measures.rollout import Rollout
from deepkoco.koopman.latent_model import Array
from deepkoco.output.colours import COLOURS
from deepkoco.output.picture import Picture


@dataclass(frozen=True)
class HorizonErrors:
    """Errors h = 0 .. H steps ahead.

    Attributes:
        latent: Root mean square distance of predicted and encoded latents, in spreads of the encoded latents
            (H + 1,); 1 is as bad as predicting the mean.
        cost: Root mean square error of the predicted cost (H + 1,) [cost].
        cost_median: Median absolute error of the predicted cost (H + 1,) [cost].
        mean_cost: Root mean square error of predicting the mean cost of that step (H + 1,) [cost].
    """

    latent: Array
    cost: Array
    cost_median: Array
    mean_cost: Array


def horizon_errors(rollout: Rollout) -> HorizonErrors:
    """Errors over all windows.

    Args:
        rollout: Predictions and what came true.

    Returns:
        The errors; latents that never move (a constant entry) do not count.
    """
    flat = rollout.encoded.reshape(-1, rollout.encoded.shape[-1])
    spread = float(np.square(flat - flat.mean(0)).sum(-1).mean())
    distance = np.square(rollout.latents - rollout.encoded).sum(-1).mean(0)
    error = rollout.predicted_costs - rollout.costs
    return HorizonErrors(
        latent=np.sqrt(distance / spread) if spread > 0 else np.zeros_like(distance),
        cost=np.sqrt(np.square(error).mean(0)),
        cost_median=np.median(np.abs(error), axis=0),
        mean_cost=rollout.costs.std(0),
    )


def draw_horizon(
    errors: Mapping[str, HorizonErrors], trained: int | None, planned: int, time_step: float, windows: int
) -> Picture:
    """Errors of one or two models against the horizon.

    Args:
        errors: By method, a key of `COLOURS`.
        trained: T of the training; None where it is not known.
        planned: H of the planner.
        time_step: Seconds per step.
        windows: How many windows there were.

    Returns:
        The picture.
    """
    figure = Figure(figsize=(9.0, 3.6))
    left, right = figure.subplots(1, 2)
    frames = []
    for method, found in errors.items():
        steps = np.arange(found.cost.size)
        left.plot(steps, found.cost, color=COLOURS[method], label=method)
        right.plot(steps[1:], found.latent[1:], color=COLOURS[method], label=method)
        frames.append(
            pd.DataFrame(
                {
                    "method": method,
                    "step": steps,
                    "time_s": steps * time_step,
                    "cost_rms_error": found.cost,
                    "cost_median_error": found.cost_median,
                    "latent_relative_error": found.latent,
                    "cost_error_of_the_mean": found.mean_cost,
                }
            )
        )
    first = next(iter(errors.values()))
    left.plot(first.mean_cost, color=COLOURS["muted"], linestyle="--", label="predicting the mean")
    left.set(xlabel="steps ahead", ylabel="error of the predicted cost", ylim=(0.0, _top(errors, first)))
    right.axhline(1.0, color=COLOURS["muted"], linestyle="--")
    right.set(xlabel="steps ahead", ylabel="error of the latent / its spread", yscale="log")
    for axes in (left, right):
        _mark(axes, trained, planned)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    at = planned
    caption = (
        f"From {windows} moments of new episodes the model predicts what follows under the actions that were really "
        f"taken; the left panel is the error of the cost, {first.cost[at]:.2g} after the {at} steps that the planner "
        f"looks ahead, against {first.mean_cost[at]:.2g} for predicting the mean. Beyond T, the longest window of "
        "the training, nothing was learned and errors may grow without bound."
    )
    latent = first.latent[at]
    caption += f" The latent state itself is off by {latent:.2g} times its spread there" + (
        ": it is only the cost that is predicted, not the whole latent state." if latent > 1.0 else "."
    )
    if "EDMDc" in errors:
        caption += (
            f" EDMDc, a linear model with fixed instead of learned features, has {errors['EDMDc'].cost[at]:.2g} there; "
            "its latent is another one, so the right panel compares each model with itself."
        )
    return Picture(
        "error_by_horizon", "How far ahead do predictions hold?", caption, figure, pd.concat(frames)
    )


def _top(errors: Mapping[str, HorizonErrors], first: HorizonErrors) -> float:
    """Show what is below three times the mean predictor; what diverges leaves the picture."""
    largest = max(float(found.cost.max()) for found in errors.values())
    return 1.05 * min(largest, 3.0 * float(first.mean_cost.max())) or 1.0


def _mark(axes: Axes, trained: int | None, planned: int) -> None:
    marks = {planned: "H"} if trained is None else {planned: "H", trained: "T"}
    if trained == planned:
        marks = {planned: "T = H"}
    for place, text in marks.items():
        axes.axvline(place, color=COLOURS["measured"], linewidth=0.8, linestyle=":")
        axes.annotate(
            text, (place, 1.0), xycoords=("data", "axes fraction"), xytext=(2, -2),
            textcoords="offset points", va="top", fontsize=9,
        )  # fmt: skip
