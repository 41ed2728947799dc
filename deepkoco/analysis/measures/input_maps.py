"""Where the action matters and where the cost looks: size of B and C over the plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure

from deepkoco.analysis.measures.points import Points, paint
from deepkoco.koopman.latent_model import Array, LatentModel
from deepkoco.output.colours import MAGNITUDE, SIGNED
from deepkoco.output.picture import Picture


@dataclass(frozen=True)
class InputMaps:
    """B and C over n points.

    Attributes:
        input_size: |B| (n, M): length of each column.
        factor_size: |C| (n,), Frobenius.
        gain: |C B| (n, M): change of the square root of the cost per unit of the action, or C B itself with one
            row in C.
        cost: Predicted cost (n,).
    """

    input_size: Array
    factor_size: Array
    gain: Array
    cost: Array


def input_maps(model: LatentModel, points: Points, action: Array) -> InputMaps:
    """Evaluate B, C and C B over the points at one action (M,)."""
    rows, factors = model.linearise(
        points.observations, np.broadcast_to(action, (len(points.x), action.size))
    )
    columns = rows[:, 1:]  # (n, M, 2P)
    gain = columns @ factors.swapaxes(-1, -2)  # (n, M, r)
    readout = np.square((factors * rows[:, :1]).sum(-1)).sum(-1)
    return InputMaps(
        input_size=np.linalg.norm(columns, axis=-1),
        factor_size=np.linalg.norm(factors, axis=(-2, -1)),
        gain=gain[..., 0] if model.cost_rank == 1 else np.linalg.norm(gain, axis=-1),
        cost=readout + (model.action_weight * np.square(action)).sum(),
    )


def draw_input_maps(model: LatentModel, points: Points, action: Array) -> Picture:
    """Maps of |B|, |C|, C B and the predicted cost."""
    maps = input_maps(model, points, action)
    actions = maps.input_size.shape[1]
    panels = [(f"|B|{_of(i, actions)}", maps.input_size[:, i], False) for i in range(actions)]
    panels += [("|C|", maps.factor_size, False)]
    panels += [(f"C B{_of(i, actions)}", maps.gain[:, i], model.cost_rank == 1) for i in range(actions)]
    panels += [("predicted cost", maps.cost, False)]
    columns = 4 if len(panels) <= 4 else 3
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(10.0, 2.7 * rows))
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for place, (title, values, signed) in zip(axes.ravel(), panels, strict=False):
        reach = max(float(np.abs(values).max()), 1e-12)
        norm = TwoSlopeNorm(0.0, -reach, reach) if signed else Normalize(0.0, reach)
        drawn = paint(place, points, values, SIGNED if signed else MAGNITUDE, norm)
        place.set_title(title)
        bar = figure.colorbar(drawn, ax=place, pad=0.02)
        bar.ax.tick_params(labelsize=7)
        place.tick_params(labelsize=7)
    for place in axes.ravel()[len(panels) :]:
        place.set_visible(False)
    for place in axes[-1]:
        place.set_xlabel(points.labels[0], fontsize=8)
    for place in axes[:, 0]:
        place.set_ylabel(points.labels[1], fontsize=8)
    table = {"x": points.x, "y": points.y}
    for i in range(actions):
        table |= {f"B_size_{i}": maps.input_size[:, i], f"CB_{i}": maps.gain[:, i]}
    table |= {"C_size": maps.factor_size, "predicted_cost": maps.cost}
    caption = (
        f"How the model sees {points.described()} at action {', '.join(f'{a:.2g}' for a in action)}: |B| is how "
        "far a unit of action moves the latent state, |C| how strongly the latent state counts for the cost. C B is "
        "their product, the immediate pull of the action on the square root of the cost; where it is near zero the "
        "planner acts only for what comes later."
    )
    return Picture("input_maps", "Where does the action matter?", caption, figure, pd.DataFrame(table))


def _of(action: int, actions: int) -> str:
    return f" of action {action + 1}" if actions > 1 else ""
