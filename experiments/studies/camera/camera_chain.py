"""Study: a pendulum, its camera and its delays from 21 s of pictures, as in thesis Fig. 4.5 and 4.6.

    python -m experiments.studies.camera.camera_chain --units 5 --out results/identify/camera

A rendered camera sees a disk pendulum: a cluttered wall, exposure, noise, a random age of each picture. The nodes of
`deepkoco.vision` read the angle with OpenCV. From one log of each hidden unit 20 parameters are fitted: of the motion,
of the camera and of the delays. On a second log the motion is then simulated for 21 s without a look. Beside that fit
stand one that knows no camera delay, one that trusts the nominal camera, and one without a tachometer.

A unit is written as soon as it is done: a study that was stopped goes on where it was when called again.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from deepkoco.fit import Identification
from deepkoco.output.whole_file import whole_file
from deepkoco.vision import angle_of_pixel
from deepkoco.vision.chain import CHAIN, source_starts
from deepkoco.vision.projection import CAMERA as DECLARED
from experiments.studies.camera.combinations import combination_rows
from experiments.studies.camera.fits import FREE, LENGTH, OPEN_LOOP, SETTLING, TRUE, identify, open_loop
from experiments.studies.camera.units import HiddenUnit, Taken, learned_background, record

TABLES = ("units", "estimates", "open_loop")
CURVE_RATE = 20.0  # of the angles that are kept [Hz]


def reading_error(taken: Taken, values: dict[str, float]) -> float:
    """Root mean square error of the angle that is read with a camera and its delay, both as believed [rad].

    Args:
        taken: A recording.
        values: Believed parameters; those of the camera that are left out are nominal.
    """
    stamps, pixels = source_starts(taken.graph, taken.episode, CHAIN[:-1]), taken.episode.outputs["ellipse"]
    good = np.isfinite(stamps) & np.isfinite(pixels[:, 0])
    camera = {p.name: torch.tensor(values.get(p.name, p.value), dtype=torch.float64) for p in DECLARED}
    u, v = (torch.from_numpy(pixels[good, column]) for column in (0, 1))
    angle = angle_of_pixel(u, v, camera)[0].numpy()
    error = angle - np.interp(stamps[good] - values.get("camera_delay", 0.0), *taken.truth)
    return float(np.sqrt(np.mean(np.angle(np.exp(1j * error)) ** 2)))


def estimate_rows(found: Identification, true: dict[str, float]) -> list[dict[str, object]]:
    """Every fitted parameter, then the combinations that a log identifies."""
    own = [
        {
            "parameter": name,
            "unit": e.unit,
            "true": true[name],
            "found": e.value,
            "low": e.low,
            "high": e.high,
        }
        for name, e in found.estimates.items()
    ]
    return own + combination_rows(found, true)


def study_unit(seed: int) -> dict[str, list[dict[str, object]]]:
    """All fits of one unit: rows of each table of `TABLES`."""
    began = time.process_time()
    unit = HiddenUnit.draw(seed)
    background = learned_background(unit)
    first, second = (record(unit, background, LENGTH, number) for number in (1, 2))
    recorded = time.process_time() - began
    rows: dict[str, list[dict[str, object]]] = {name: [] for name in TABLES}
    for kind in (*FREE, TRUE):
        if kind == TRUE:
            values, seconds, loose = unit.values, 0.0, ()
        else:
            found, seconds = identify(first.log, kind)
            values = {name: e.value for name, e in found.estimates.items()}
            loose = found.loose_in_words()
            rows["estimates"] += [
                {"seed": seed, "fit": kind, **row} for row in estimate_rows(found, unit.values)
            ]
        ahead = open_loop(values, second)
        read, there = second.episode.outputs["angle"][:, 0], second.log.channels["bearing"].t
        rows["units"].append(
            {
                "seed": seed,
                "fit": kind,
                "open_loop_rms_deg": np.rad2deg(ahead.rms),
                "reading_rms_deg": np.rad2deg(reading_error(second, values)),
                "largest_angle_deg": np.rad2deg(np.abs(np.abs(ahead.true) - np.pi).max()),
                "pictures": len(read),
                "pictures_used": len(there),
                "loose": len(loose),
                "fit_cpu_s": seconds,
                "recording_cpu_s": recorded,
            }
        )
        grid = np.arange(SETTLING, SETTLING + OPEN_LOOP, 1.0 / CURVE_RATE)
        for t, angle, true in zip(
            grid, np.interp(grid, ahead.t, ahead.angle), np.interp(grid, ahead.t, ahead.true), strict=True
        ):
            rows["open_loop"].append(
                {
                    "seed": seed,
                    "fit": kind,
                    "time_s": t,
                    "true_deg": np.rad2deg(true),
                    "angle_deg": np.rad2deg(angle),
                }
            )
    return rows


def read_tables(folder: Path) -> dict[str, pd.DataFrame]:
    """What an earlier call has left there."""
    return {
        name: pd.read_csv(path) if (path := folder / f"{name}.csv").exists() else pd.DataFrame()
        for name in TABLES
    }


def write_tables(tables: dict[str, pd.DataFrame], folder: Path) -> None:
    """Write every table whole; `units` comes last, since it says which units are done."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in reversed(TABLES):
        with whole_file(folder / f"{name}.csv") as partial:
            tables[name].to_csv(partial, index=False, lineterminator="\n", float_format="%.6g")


def main(argv: list[str] | None = None) -> int:
    """Run the study over several units."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--units", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0, help="of the first unit")
    parser.add_argument("--out", type=Path, default=Path("results/identify/camera"))
    parser.add_argument("--no-film", action="store_true", help="tables and figures only")
    parser.add_argument("--clip", action="store_true", help="write the film as film.webm, too")
    args = parser.parse_args(argv)
    if args.units < 1:
        parser.error("--units: at least one")
    tables = read_tables(args.out)
    done = set() if tables["units"].empty else set(tables["units"].seed)
    for seed in range(args.seed, args.seed + args.units):
        if seed in done:
            continue
        rows = study_unit(seed)
        tables = {name: pd.concat([tables[name], pd.DataFrame(rows[name])]) for name in TABLES}
        write_tables(tables, args.out)
    # Figures and text are made anew of all units that are there.
    from experiments.studies.camera.report import write_report

    write_report({name: table.reset_index(drop=True) for name, table in tables.items()}, args.out)
    if not args.no_film:
        from experiments.studies.camera.film import write_film

        write_film(args.seed, tables, args.out, args.clip)
    return 0


if __name__ == "__main__":
    sys.exit(main())
