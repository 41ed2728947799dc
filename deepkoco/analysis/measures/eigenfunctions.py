"""Eigenfunctions of the most important pairs: magnitude and phase over the plane at several actions."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from deepkoco.analysis.measures.contribution import Contribution
from deepkoco.analysis.measures.modes import ComplexArray, Modes
from deepkoco.analysis.measures.points import Points, paint
from deepkoco.koopman.latent_model import Array, LatentModel
from deepkoco.output.colours import MAGNITUDE, PHASE
from deepkoco.output.picture import Picture

SHOWN_PAIRS = 3
TABLE_POINTS = 700


def evaluate_eigenfunctions(model: LatentModel, modes: Modes, points: Points, action: Array) -> ComplexArray:
    """Mode coordinates z_p over the points at one action.

    Args:
        model: The latent model.
        modes: Of its dynamics.
        points: n points.
        action: (M,).

    Returns:
        (n, P); with zero increments a step multiplies column p by lambda_p, as far as the model is right.
    """
    rows, _ = model.linearise(points.observations, np.broadcast_to(action, (len(points.x), action.size)))
    return modes.coordinates(rows[:, 0])


def draw_eigenfunctions(
    model: LatentModel,
    modes: Modes,
    contribution: Contribution,
    points: Points,
    action_low: Array,
    action_high: Array,
) -> Picture:
    """Magnitude and phase of the pairs with the largest parts of the cost, at least, middle and largest action."""
    actions = [action_low, 0.5 * (action_low + action_high), action_high]
    shown = np.argsort(-np.abs(contribution.parts))[:SHOWN_PAIRS]
    values = [evaluate_eigenfunctions(model, modes, points, action) for action in actions]
    figure = Figure(figsize=(10.0, 2.0 * len(shown) + 0.5))
    axes = figure.subplots(len(shown), 2 * len(actions), sharex=True, sharey=True, squeeze=False)
    phase_norm = Normalize(-np.pi, np.pi)
    for row, pair in enumerate(shown):
        reach = max(float(np.abs(v[:, pair]).max()) for v in values)
        norm = Normalize(0.0, reach)
        for column, (action, z) in enumerate(zip(actions, values, strict=True)):
            left, right = axes[row, column], axes[row, len(actions) + column]
            paint(left, points, np.abs(z[:, pair]), MAGNITUDE, norm)
            paint(right, points, np.angle(z[:, pair]), PHASE, phase_norm)
            if row == 0:
                text = ", ".join(f"{value:.2g}" for value in action)
                left.set_title(f"|z|, action {text}", fontsize=9)
                right.set_title(f"phase, action {text}", fontsize=9)
            if row == len(shown) - 1:
                left.set_xlabel(points.labels[0], fontsize=8)
                right.set_xlabel(points.labels[0], fontsize=8)
        axes[row, 0].set_ylabel(f"pair {pair + 1}\n{points.labels[1]}", fontsize=8)
        bar = figure.colorbar(
            ScalarMappable(norm, MAGNITUDE), ax=axes[row, : len(actions)], pad=0.01, aspect=12
        )
        bar.ax.tick_params(labelsize=7)
        bar = figure.colorbar(
            ScalarMappable(phase_norm, PHASE), ax=axes[row, len(actions) :], pad=0.01, aspect=12
        )
        bar.set_ticks([-np.pi, 0.0, np.pi], labels=["−π", "0", "π"], fontsize=7)
    for panel in axes.ravel():
        panel.tick_params(labelsize=7)
    caption = (
        f"An eigenfunction turns what the agent sees into one complex number that should grow and rotate evenly in "
        f"time; the {len(shown)} that matter most for the cost are shown over {points.described()}, magnitude left "
        "and phase right. Smooth maps with few seams are easier to predict; the phase means nothing where the "
        "magnitude is near zero."
    )
    few = points.thinned(TABLE_POINTS)
    frames = []
    for action in actions:
        z = evaluate_eigenfunctions(model, modes, few, action)
        for pair in range(z.shape[1]):
            frame = {"pair": pair + 1} | {f"action_{i}": value for i, value in enumerate(action)}
            frame |= {
                "x": few.x,
                "y": few.y,
                "magnitude": np.abs(z[:, pair]),
                "phase_rad": np.angle(z[:, pair]),
            }
            frames.append(pd.DataFrame(frame))
    return Picture("eigenfunctions", "What do the pairs measure?", caption, figure, pd.concat(frames))
