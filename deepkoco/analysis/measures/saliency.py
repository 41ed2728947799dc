"""Where a model on images looks: how far the latent moves when a patch of the frames is covered."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.output.picture import Picture

PATCH, STRIDE = 8, 4  # [pixels]
SHOWN = 5


def occlusion_map(model: ExportedModel, frames: np.ndarray, background: np.ndarray, action: Array) -> Array:
    """Move a patch of background over the frames of one observation.

    Args:
        model: A model on images.
        frames: The d frames of the observation, oldest first, uint8 (d, H, W, 3).
        background: What is put into the patch, uint8 (H, W, 3).
        action: (M,).

    Returns:
        Length of the change of the latent for each place of the patch (rows, columns), the patch covering rows
        STRIDE i .. STRIDE i + PATCH.
    """
    encoder = model.frame_encoder
    assert encoder is not None
    rows = range(0, frames.shape[1] - PATCH + 1, STRIDE)
    columns = range(0, frames.shape[2] - PATCH + 1, STRIDE)
    covered = [frames]
    for row in rows:
        for column in columns:
            copy = frames.copy()
            patch = np.s_[row : row + PATCH, column : column + PATCH]
            copy[(slice(None), *patch)] = background[patch]
            covered.append(copy)
    stacked = np.stack(covered)  # (1 + places, d, H, W, 3)
    features = encoder.encode(stacked).reshape(len(stacked), -1)
    latents, _ = model.linearise(features, np.broadcast_to(action, (len(stacked), action.size)))
    change = np.linalg.norm(latents[1:, 0] - latents[0, 0], axis=-1)
    return change.reshape(len(rows), len(columns))


def draw_saliency(model: ExportedModel, frames: np.ndarray, actions: Array, spread: float) -> Picture:
    """Newest frame of some observations, and what covering it changes.

    Args:
        model: A model on images.
        frames: One episode's frames, uint8 (L, H, W, 3).
        actions: Its actions (L, M).
        spread: Root mean square distance of the latent from its mean, the unit of the maps.

    Returns:
        The picture.
    """
    encoder = model.frame_encoder
    assert encoder is not None
    history = encoder.frames
    background = np.median(frames[:: max(1, len(frames) // 100)], axis=0).astype(np.uint8)
    chosen = np.linspace(history - 1, len(frames) - 1, SHOWN).round().astype(int)
    maps = [
        occlusion_map(model, frames[k - history + 1 : k + 1], background, actions[k]) / spread for k in chosen
    ]
    reach = max(float(m.max()) for m in maps) or 1.0
    figure = Figure(figsize=(10.0, 4.2))
    axes = figure.subplots(2, SHOWN, squeeze=False)
    height, width = frames.shape[1:3]
    half = (PATCH - STRIDE) / 2
    rows = []
    drawn = None
    for column, (k, values) in enumerate(zip(chosen, maps, strict=True)):
        extent = (half, half + STRIDE * values.shape[1], half + STRIDE * values.shape[0], half)
        axes[0, column].imshow(frames[k])
        axes[0, column].set_title(f"step {k}", fontsize=9)
        axes[1, column].imshow(frames[k].mean(-1), cmap="gray", alpha=0.35)
        drawn = axes[1, column].imshow(values, cmap="magma", vmin=0.0, vmax=reach, alpha=0.75, extent=extent)
        axes[1, column].set(xlim=(0, width), ylim=(height, 0))
        for (i, j), value in np.ndenumerate(values):
            rows.append({"step": k, "row": STRIDE * i, "column": STRIDE * j, "change": value})
    for panel in axes.ravel():
        panel.set_axis_off()
    assert drawn is not None
    figure.colorbar(drawn, ax=axes[1], label="change / spread of the latent", pad=0.01)
    caption = (
        f"Above, what the agent sees; below, how far the latent state moves when a patch of {PATCH} by {PATCH} pixels "
        "is covered with what usually is there. Bright places are those the model relies on: a good one is bright on "
        "the moving part of the task and dark on everything else."
    )
    return Picture(
        "saliency", "Where in the picture does the model look?", caption, figure, pd.DataFrame(rows)
    )
