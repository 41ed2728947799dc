"""Which inputs the model looks at: sensitivity of the latent and of the predicted cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from deepkoco.analysis.measures.inputs import Inputs
from deepkoco.koopman.latent_model import Array, LatentModel
from deepkoco.output.colours import COLOURS
from deepkoco.output.picture import Picture

STEP = 1e-3  # of the spread of an input


@dataclass(frozen=True)
class Sensitivity:
    """Root mean square derivatives by input, times the input's spread.

    Attributes:
        latent: Of the latent, in spreads of the latent (N,).
        cost: Of the cost predicted over the horizon with the action held, in spreads of that cost (N,).
    """

    latent: Array
    cost: Array


def held_cost(model: LatentModel, observations: Array, actions: Array, horizon: int) -> tuple[Array, Array]:
    """Latents (K, n), and mean predicted cost (K,) over 0 .. H steps with the action held."""
    rows, factors = model.linearise(observations, actions)
    latent = np.ascontiguousarray(rows[:, 0])
    first, total = latent, np.zeros(len(latent))
    for _ in range(horizon + 1):
        total += np.square((factors * latent[:, None]).sum(-1)).sum(-1)
        latent = model.dynamics.advance(latent)
    return first, total / (horizon + 1) + (model.action_weight * np.square(actions)).sum(-1)


def input_sensitivity(model: LatentModel, observations: Array, actions: Array, horizon: int) -> Sensitivity:
    """Derivatives by central differences at visited points.

    Args:
        model: The latent model.
        observations: (K, N), a sample of what was visited.
        actions: (K, M).
        horizon: H, steps over which cost is predicted.

    Returns:
        The sensitivities; exactly zero for inputs the model ignores, and for inputs that never move.
    """
    latents, costs = held_cost(model, observations, actions, horizon)
    latent_spread = np.sqrt(np.square(latents - latents.mean(0)).sum(-1).mean())
    cost_spread = costs.std()
    spreads = observations.std(0)
    found = np.zeros((2, spreads.size))
    for i in np.flatnonzero(spreads > 0):
        step = np.zeros(spreads.size)
        step[i] = STEP * spreads[i]
        above, below = (held_cost(model, observations + sign * step, actions, horizon) for sign in (1, -1))
        change = np.square(above[0] - below[0]).sum(-1).mean(), np.square(above[1] - below[1]).mean()
        found[:, i] = np.sqrt(change) / (2.0 * STEP)
    scale = np.array([[latent_spread], [cost_spread]])
    found = np.divide(found, scale, out=np.zeros_like(found), where=scale > 0)
    return Sensitivity(found[0], found[1])


def draw_sensitivity(sensitivity: Sensitivity, inputs: Inputs) -> Picture:
    """Bars by input, those of the task first.

    Args:
        sensitivity: Of N inputs.
        inputs: Their names, and which belong to the task.

    Returns:
        The picture.
    """
    order, names = inputs.listed, inputs.names
    mixed = inputs.is_task is None
    is_task = np.ones(len(names), dtype=bool) if inputs.is_task is None else inputs.is_task
    table = pd.DataFrame(
        {
            "input": [names[i] for i in order],
            "belongs_to": np.where(mixed, "mixed", np.where(is_task[order], "task", "distractor")),
            "latent_sensitivity": sensitivity.latent[order],
            "cost_sensitivity": sensitivity.cost[order],
        }
    )
    figure = Figure(figsize=(9.0, 1.6 + 0.22 * len(order)))
    panels = figure.subplots(1, 2, sharey=True)
    colours = [COLOURS["DeepKoCo"] if is_task[i] else COLOURS["muted"] for i in order]
    place = np.arange(len(order))
    for axes, column, label in zip(
        panels, ("latent_sensitivity", "cost_sensitivity"), ("latent state", "predicted cost"), strict=True
    ):
        axes.barh(place, table[column], color=colours)
        axes.set(xlabel=f"sensitivity of the {label}")
        axes.grid(axis="y", visible=False)
    panels[0].set_yticks(place, table["input"].tolist(), fontsize=9 if len(order) < 20 else 7)
    panels[0].invert_yaxis()
    caption = (
        "How much the latent state and the predicted cost move when one input moves, each measured in its usual "
        "spread: 1 means that a typical move of the input moves the output by a typical amount."
    )
    if mixed:
        caption += " Every input mixes the task with distractors here, so no bar belongs to either."
    elif is_task.all():
        caption += (
            " All inputs belong to the task here, so long bars are expected; a short one is an input that is not "
            "needed."
        )
    else:
        handles = [
            Patch(color=COLOURS["DeepKoCo"], label="task"),
            Patch(color=COLOURS["muted"], label="distractor"),
        ]
        panels[1].legend(handles=handles, loc="lower right")
        ratios = []
        for values in (sensitivity.latent, sensitivity.cost):
            theirs = float(np.sqrt(np.square(values[~is_task]).mean()))
            ratios.append(float(np.sqrt(np.square(values[is_task]).mean())) / theirs if theirs else np.inf)
        caption += (
            f" A good model looks at the task and not at what distracts: here the latent state is {ratios[0]:.3g} "
            f"times and the predicted cost {ratios[1]:.3g} times as sensitive to a task input as to a distractor."
        )
    return Picture("sensitivity", "Which inputs does the model look at?", caption, figure, table)
