"""How much each mode contributes to the predicted cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.analysis.measures.modes import Modes
from deepkoco.analysis.measures.steps import Steps
from deepkoco.koopman.latent_model import Array, LatentModel
from deepkoco.output.colours import COLOURS
from deepkoco.output.picture import Picture


@dataclass(frozen=True)
class Contribution:
    r"""The predicted state cost $|y|^2$, $y = C s = \sum_p y_p$, split over the modes.

    The part of mode p is $E[y \cdot y_p]$: the parts sum to the mean cost exactly, and they are the Shapley values
    of the game in which a set of modes earns the mean cost $E|\sum_{p \in S} y_p|^2$. A negative part takes cost
    away that other modes predict too much of.

    Attributes:
        parts: E[y . y_p] (P,) [cost].
        sizes: sqrt(E|y_p|^2) (P,) [square root of cost]: how much moves through a mode, cancelling or not.
        total: E|y|^2, the sum of the parts [cost].
        action_cost: E[R a'a], which no mode carries [cost].
    """

    parts: Array
    sizes: Array
    total: float
    action_cost: float

    @property
    def shares(self) -> Array:
        """Parts as fractions of the total (P,); they sum to 1."""
        return self.parts / self.total if self.total else np.zeros_like(self.parts)


def cost_contribution(model: LatentModel, modes: Modes, steps: Steps) -> Contribution:
    """Split the predicted cost over recorded steps.

    Args:
        model: The latent model.
        modes: Of its dynamics.
        steps: Where it is evaluated.

    Returns:
        The split, averaged over the steps.
    """
    rows, factors = model.linearise(steps.observations, steps.actions)
    split = modes.split_readout(factors, rows[:, 0])  # (K, r, P)
    readout = split.sum(-1, keepdims=True)
    return Contribution(
        parts=(readout * split).sum(1).mean(0),
        sizes=np.sqrt(np.square(split).sum(1).mean(0)),
        total=float(np.square(readout).sum(1).mean()),
        action_cost=float(np.sum(model.action_weight * np.square(steps.actions), -1).mean()),
    )


def draw_contribution(contribution: Contribution, modes: Modes) -> Picture:
    """Bars of the parts, the largest first."""
    order = np.argsort(-np.abs(contribution.parts))
    rates = modes.continuous
    table = pd.DataFrame(
        {
            "pair": order + 1,
            "mu_per_s": rates.real[order],
            "omega_rad_per_s": rates.imag[order],
            "part_of_cost": contribution.parts[order],
            "share": contribution.shares[order],
            "rms_of_output": contribution.sizes[order],
        }
    )
    figure = Figure(figsize=(9.0, 3.4))
    axes = figure.subplots()
    place = np.arange(len(order))
    axes.bar(place, table["part_of_cost"], color=COLOURS["DeepKoCo"], width=0.7)
    axes.axhline(0.0, color="#222222", linewidth=0.8)
    labels = [
        f"{p}\n{m:+.1f}\n{w:.1f}"
        for p, m, w in zip(table["pair"], table["mu_per_s"], table["omega_rad_per_s"], strict=True)
    ]
    axes.set_xticks(place, labels, fontsize=8 if len(order) <= 16 else 5)
    axes.set_xlabel("number of the pair, its growth rate [1/s], its frequency [rad/s]")
    axes.set_ylabel("part of the mean cost")
    axes.grid(axis="x", visible=False)
    caption = (
        f"The model predicts cost as the square of a sum over its {len(order)} eigenvalue pairs; the bars split the "
        f"mean predicted cost of {contribution.total:.3g} per step over the pairs without remainder (a further "
        f"{contribution.action_cost:.2g} is the price of the action itself). A bar below zero belongs to a pair that "
        "takes back cost which other pairs overstate, so large bars of both signs mean that pairs work against each "
        "other."
    )
    return Picture("contribution", "Which pairs make the cost?", caption, figure, table)
