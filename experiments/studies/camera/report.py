"""The README of the study of the camera chain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.graph.drawing.style import write_whole
from deepkoco.output.whole_file import whole_file
from experiments.plumbing.provenance import as_markdown
from experiments.studies.camera.combinations import COMBINATIONS
from experiments.studies.camera.figures import (
    FITS,
    GOAL,
    draw_errors,
    draw_estimates,
    draw_open_loop,
    geometric_mean,
)
from experiments.studies.camera.fits import ALL, FREE
from experiments.studies.camera.units import CAMERA, DELAYS, JITTER

KNOWS = {
    "true values": "nothing is fitted: the limit of the construction",
    "all": f"{len(ALL)} parameters",
    "no camera delay": "as all; a picture is believed to show the time of its stamp",
    "camera alone": "as all; the log has no tachometer, so only the sum of both delays is open to it",
    "nominal camera": "as all; the camera is believed to stand straight in front of the pivot, at its nominal place",
}


WHITE = """Where the same motions are seen through the camera model with white noise of 0.05 pixels, without pictures
(`python -m experiments.studies.camera.white_pixels`, `white_pixels.csv`), so many hold it:
{}. So what is missing comes from the pictures: their middles are wrong by some hundredths of a pixel in a way that does
not average out. The residuals of unit 2, the one that was looked at, are white and do not show it.
"""


def write_report(tables: dict[str, pd.DataFrame], folder: Path) -> None:
    """Draw the figures beside their tables, and write the README.

    Args:
        tables: As the study made them.
        folder: Where they lie.
    """
    drawn = {
        "units": draw_errors(tables["units"]),
        "open_loop": draw_open_loop(tables["open_loop"]),
        "estimates": draw_estimates(tables["estimates"]),
    }
    for name, figure in drawn.items():
        save_figure(figure, folder / f"{name}.png")
    with whole_file(folder / "README.md") as partial:
        path = folder / "white_pixels.csv"
        partial.write_text(readme(tables, pd.read_csv(path) if path.exists() else None), encoding="utf-8")


def readme(tables: dict[str, pd.DataFrame], white: pd.DataFrame | None = None) -> str:
    """Its text.

    Args:
        tables: As the study made them.
        white: Estimates from pixels with white noise, where that program has run.
    """
    units, estimates = tables["units"], tables["estimates"]
    seeds = sorted(units.seed.unique())
    used = units[units.fit == "all"]
    share = 100.0 * used.pictures_used.sum() / used.pictures.sum()
    alone = [1e3 * _worst(estimates, "camera alone", name) for name in ("sum of both delays", "camera_delay")]
    noise = "" if white is None else WHITE.format(_coverage(white))
    return f"""# A pendulum, its camera and its delays from 21 s of pictures

`python -m experiments.studies.camera.camera_chain --units {len(seeds)} --seed {seeds[0]} --out results/identify/camera`

What the study is about: [docs/camera.md](../../../docs/camera.md). {len(seeds)} hidden units, seeds {seeds[0]} to
{seeds[-1]}. Each has parameters of the pendulum up to 10 % from nominal, its own camera, wall, delays and tachometer.
A log of 22.5 s is fitted. On a second log, of other commands, the state is found from the first second, and 21 s are
simulated without a look at the sensors. A value is the geometric mean over the units with its 95 % interval (Student's
t on the logarithms, because errors of units differ by factors), then the smallest and the largest.

| fit | knows | open loop, rms [deg] | times that of all | below {GOAL:g} deg | reading, rms [deg] | CPU s |
|---|---|---|---|---|---|---|
{_errors(units)}

The angle is compared with the true one at its true time: a wrong delay shows as an error wherever the pendulum moves.
The error of the reading is that of the nodes alone, with the camera and the delay that the fit has found; pictures are
{1e3 * JITTER:g} ms older or younger than the mean at random. CPU s: processor time of a fit, median. Recording a unit
(the film of the background and both logs) takes {used.recording_cpu_s.median():.0f} s. {share:.0f} % of the pictures
were used: where a patch of the wall in the colour of the mass hides a part of it, the picture is left out.

Largest errors of the delays over the units: {_largest(estimates, "all")}. With the camera alone the sum of both is
wrong by up to {alone[0]:.2f} ms, and each of the two by up to {alone[1]:.1f} ms.

What the motion identifies, largest relative error of the fit of all: {_combinations(estimates)}. Single masses, lengths
and motor constants are not identified: the fit says so, and their intervals are as wide as their bounds.

**Intervals are too narrow.** So many 95 % intervals of the fit of all hold the true value: {_coverage(estimates)}.
{noise}
**What is not compared.** The thesis counts 27 parameters; we could not look up which. Ours are {len(ALL)}, listed in
[docs/camera.md](../../../docs/camera.md), beside the noise of three channels, the scatter of the stamps and a start
state of each window, which the fit finds too. Units and model share the equations of the pendulum: what is hidden from
the fit is the camera (exposure, random age, edges of pixels, the middle of a disc that is not the middle of its image).

![errors](units.png)

![angles](open_loop.png)

![estimates](estimates.png)

![film](film.png)

The film (with `--clip` also as `film.webm`), top down: the picture with a ring where the open-loop simulation believes
the mass, what moved, and the share of the mass in each pixel.

{as_markdown()}
"""


def _errors(units: pd.DataFrame) -> str:
    rows = []
    for kind in FITS:
        own = units.loc[units.fit == kind]
        values = [
            _interval(np.asarray(own[c], dtype=float)) for c in ("open_loop_rms_deg", "reading_rms_deg")
        ]
        below = f"{int((own.open_loop_rms_deg < GOAL).sum())} of {len(own)}"
        seconds = f"{own.fit_cpu_s.median():.1f}" if kind in FREE else ""
        rows.append(
            f"| {kind} | {KNOWS[kind]} | {values[0]} | {_ratio(units, kind)} | {below} | {values[1]} | {seconds} |"
        )
    return "\n".join(rows)


def _interval(values: np.ndarray) -> str:
    mean, low, high = geometric_mean(values)
    return f"{mean:.3g} [{low:.3g}, {high:.3g}], {values.min():.2g} to {values.max():.3g}"


def _ratio(units: pd.DataFrame, kind: str) -> str:
    """Open-loop error by that of the fit of all, unit by unit."""
    of = units.pivot(index="seed", columns="fit", values="open_loop_rms_deg")
    if kind == "all":
        return "1"
    mean, low, high = geometric_mean(np.asarray(of[kind] / of["all"], dtype=float))
    return f"{mean:.2g} [{low:.2g}, {high:.2g}]"


def _worst(estimates: pd.DataFrame, kind: str, name: str) -> float:
    own = estimates[(estimates.fit == kind) & (estimates.parameter == name)]
    return float((own.found - own.true).abs().max())


def _largest(estimates: pd.DataFrame, kind: str) -> str:
    labels = {"actuation_delay.delay": "commands", "camera_delay": "camera"}
    return ", ".join(f"{labels[name]} {1e3 * _worst(estimates, kind, name):.2f} ms" for name in DELAYS)


def _combinations(estimates: pd.DataFrame) -> str:
    parts = []
    for name in list(COMBINATIONS)[:4]:
        own = estimates[(estimates.fit == "all") & (estimates.parameter == name)]
        parts.append(f"{name} {100.0 * (own.found / own.true - 1.0).abs().max():.2f} %")
    return ", ".join(parts)


def _coverage(estimates: pd.DataFrame) -> str:
    own = estimates[estimates.fit == "all"] if "fit" in estimates else estimates
    inside = (own.true >= own.low) & (own.true <= own.high)
    groups = {
        "delays": own.parameter.isin(DELAYS),
        "camera": own.parameter.isin(CAMERA),
        "combinations of the pendulum's": own.parameter.isin(list(COMBINATIONS)[:4]),
    }
    return ", ".join(
        f"{name} {int(inside[which].sum())} of {int(which.sum())}" for name, which in groups.items()
    )


def save_figure(figure: Figure, path: Path) -> None:
    path.unlink(missing_ok=True)
    write_whole(path, lambda file: figure.savefig(file, format="png", dpi=130, metadata={"Software": None}))
