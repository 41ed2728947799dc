"""Do the intervals of the camera chain hold where pixels are wrong by white noise alone?

    python -m experiments.studies.camera.white_pixels --units 5 --out results/identify/camera/white_pixels.csv

The motions, delays and stamps are those of the study of the camera chain. The pictures are not read: a pixel is what
the camera model says, with white noise. What is missing of 95 % there is the fit's; what is missing beyond that in the
study comes from the pictures.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from deepkoco.logs.recording import Recording
from deepkoco.output.whole_file import whole_file
from deepkoco.vision import SeenPendulum, angle_of_pixel, pixel_of_angle
from experiments.studies.camera.combinations import combination_rows
from experiments.studies.camera.fits import LENGTH, identify
from experiments.studies.camera.units import CAMERA, DELAYS, JITTER, HiddenUnit, Taken, record

NOISE = 0.05  # [px]


def with_white_pixels(taken: Taken, unit: HiddenUnit, seed: int) -> Recording:
    """The log of a recording with pixels of the camera model in the place of those that were read."""
    random = np.random.default_rng([unit.seed, seed])
    stamps = taken.log.channels["bearing"].t
    ages = unit.values["camera_delay"] + JITTER * random.normal(size=len(stamps))
    theta = torch.from_numpy(np.interp(stamps - ages, *taken.truth))
    camera = {name: torch.tensor(unit.values[name], dtype=torch.float64) for name in CAMERA}
    u, v = (
        pixel + NOISE * torch.from_numpy(random.normal(size=len(stamps)))
        for pixel in pixel_of_angle(theta, camera)
    )
    bearing, reach = angle_of_pixel(u, v, SeenPendulum().nominal_camera)
    channels = dict(taken.log.channels)
    channels["bearing"] = replace(channels["bearing"], value=np.unwrap(bearing.numpy()))
    channels["reach"] = replace(channels["reach"], value=reach.numpy())
    return replace(taken.log, channels=channels)


def main(argv: list[str] | None = None) -> int:
    """Fit the logs of all units, and say how many intervals hold the true value."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--units", type=int, default=5)
    parser.add_argument("--draws", type=int, default=2, help="of the noise, for each unit")
    parser.add_argument("--out", type=Path, default=Path("results/identify/camera/white_pixels.csv"))
    args = parser.parse_args(argv)
    rows: list[dict[str, object]] = []
    for unit in map(HiddenUnit.draw, range(args.units)):
        taken = record(unit, None, LENGTH, 1)
        for draw in range(args.draws):
            found, _ = identify(with_white_pixels(taken, unit, draw), "all")
            own = [
                {
                    "parameter": n,
                    "unit": e.unit,
                    "true": unit.values[n],
                    "found": e.value,
                    "low": e.low,
                    "high": e.high,
                }
                for n, e in found.estimates.items()
            ]
            rows += [
                {"seed": unit.seed, "draw": draw, **row} for row in own + combination_rows(found, unit.values)
            ]
    table = pd.DataFrame(rows)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(args.out) as partial:
        table.to_csv(partial, index=False, lineterminator="\n", float_format="%.6g")
    table["inside"] = (table.true >= table.low) & (table.true <= table.high)
    for label, names in (("camera", CAMERA), ("delays", DELAYS)):
        own = table[table.parameter.isin(list(names))]
        sys.stdout.write(f"{label}: {int(own.inside.sum())} of {len(own)} intervals hold the true value\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
