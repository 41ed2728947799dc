"""The film of the camera chain: pictures, what the nodes make of them, and the simulation that does not look."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure

from deepkoco.envs.film import write_clip
from deepkoco.graph.drawing.style import figure_style
from deepkoco.output.whole_file import whole_file
from deepkoco.vision import pixel_of_angle
from experiments.studies.camera.fits import LENGTH, SETTLING
from experiments.studies.camera.report import save_figure
from experiments.studies.camera.units import CAMERA, HANGING, HiddenUnit, learned_background, record

SECONDS = 5.0  # of the clip, after the start of the open loop
FRAMES = 7  # of the strip
STRIDE = 3  # of the clip's frames from one of them to the next
ZOOM = 2
RING = (30, 230, 60)  # RGB


def write_film(seed: int, tables: dict[str, pd.DataFrame], folder: Path, clip: bool = False) -> None:
    """Record the beginning of a unit's second log again, and show the open loop of the fit of all on its pictures.

    Args:
        seed: Of the unit.
        tables: As the study made them; give the fitted values and the open-loop angles.
        folder: Where `film.png` and `film.csv` go; those that are there are replaced.
        clip: Whether to write `film.webm` too: some megabytes, since noise does not compress.
    """
    unit = HiddenUnit.draw(seed)
    taken = record(unit, learned_background(unit), LENGTH, 2)
    found = tables["estimates"]
    own = found[(found.seed == seed) & (found.fit == "all")].set_index("parameter").found
    curves = tables["open_loop"]
    curve = curves[(curves.seed == seed) & (curves.fit == "all")]
    pictures, starts = taken.episode.outputs["camera"], taken.episode.t_start["camera"]
    shown = (starts[: len(pictures)] > SETTLING + 0.1) & (starts[: len(pictures)] < SETTLING + SECONDS)
    camera = {name: torch.tensor(float(own[name]), dtype=torch.float64) for name in CAMERA}
    moved, shares = (taken.episode.outputs[name] for name in ("moved", "coloured"))
    frames, rows = [], []
    for k in np.flatnonzero(shown)[::2]:
        at = starts[k] - float(own["camera_delay"])
        angle = np.deg2rad(np.interp(at, curve.time_s, curve.angle_deg))
        true = np.interp(at, *taken.truth)
        u, v = pixel_of_angle(torch.tensor(angle, dtype=torch.float64), camera)
        frames.append(frame_of(pictures[k], moved[k], shares[k], float(u), float(v)))
        rows.append({"time_s": starts[k], "true_deg": np.rad2deg(true), "open_loop_deg": np.rad2deg(angle)})
    if clip:
        (folder / "film.webm").unlink(missing_ok=True)
        write_clip(folder / "film.webm", [np.concatenate(np.split(f, 3), 1) for f in frames], 25.0)
    # Around the widest swing: most of the time a pendulum hangs.
    widest = int(np.argmax([abs(row["true_deg"] - np.rad2deg(HANGING)) for row in rows]))
    chosen = (widest + STRIDE * (np.arange(FRAMES) - FRAMES // 2)).clip(0, len(frames) - 1)
    with figure_style():
        figure = Figure(figsize=(1.5 * FRAMES, 4.9), layout="constrained")
        for axis, k in zip(np.ravel(figure.subplots(1, FRAMES)), chosen, strict=True):
            axis.imshow(frames[k])
            axis.set_title(f"{rows[k]['time_s']:.2f} s", fontsize=8)
            axis.axis("off")
    save_figure(figure, folder / "film.png")
    with whole_file(folder / "film.csv") as partial:
        pd.DataFrame(rows).to_csv(partial, index=False, lineterminator="\n", float_format="%.6g")


def frame_of(picture: np.ndarray, moved: np.ndarray, share: np.ndarray, u: float, v: float) -> np.ndarray:
    """The picture with a ring at (u, v), what moved, and the share of the mass, one below the other."""
    rows = [picture, moved, np.repeat(share[..., None], 3, -1)]
    large = [cv2.resize(row, None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_NEAREST) for row in rows]
    centre = tuple(round(ZOOM * (x + 0.5) * 16) for x in (u, v))
    cv2.circle(large[0], centre, ZOOM * 11 * 16, RING, 2, cv2.LINE_AA, 4)
    return np.concatenate(large, 0)
