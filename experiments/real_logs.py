"""Study: diagnose real measured logs and compare held-out errors with the textbook model's.

python -m experiments.real_logs --data FOLDER --log dfki_pendulum --json
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose import Diagnosis, diagnose, write_report
from deepkoco.graph.recording import LogError, Recording, read_log
from deepkoco.systems import one_joint


class Split(NamedTuple):
    """One study: which stretches of which logs are fitted, and which logs only tested."""

    system: str
    mapping: dict
    train: tuple[tuple[str, float, float], ...]  # file, from [s], to [s]
    test: tuple[tuple[str, float, float], ...]
    window: float  # [s]


DFKI_PENDULUM = Split(
    system="torque_pendulum",
    mapping={
        "system": "torque_pendulum",
        "time": {"column": "t", "unit": "s"},
        "channels": {
            # The torque from the motor current is the input: the commanded one passes a controller.
            "torque": {"column": "tau_meas", "unit": "N m", "kind": "command"},
            "theta": {"column": "pos", "unit": "rad", "kind": "measurement"},
            "omega": {"column": "vel", "unit": "rad/s", "kind": "measurement"},
        },
    },
    # Later on people push the pendulum.
    train=(("energy_shaping.csv", 0.0, 4.5), ("sac.csv", 0.1, 4.1)),
    test=(("ddp_pd.csv", 0.0, 6.0), ("direct_collocation_pd.csv", 0.0, 3.5)),
    window=1.0,
)
STUDIES = {"dfki_pendulum": DFKI_PENDULUM}


def run_study(folder: Path, split: Split) -> Diagnosis:
    """Diagnose the training stretches; measure on the test logs."""
    train, test = (
        [_stretch(folder, split, *piece) for piece in pieces] for pieces in (split.train, split.test)
    )
    return diagnose(train, split.system, holdout=test, window=split.window)


def summary(diagnosis: Diagnosis, seconds: float) -> dict:
    """The figures of one study, errors of the first channel in its unit."""
    channel = diagnosis.gain.channels[0] if diagnosis.gain else None
    first = diagnosis.causes[0] if diagnosis.causes else None
    return {
        "verdict": diagnosis.verdict,
        "first": first.name if first else None,
        "class": list(first.members) if first else [],
        "rmse_baseline": channel.baseline if channel else None,
        "rmse_refit": channel.refit if channel else None,
        "rmse_extended": channel.extended if channel else None,
        "seconds": round(seconds, 2),
    }


def _stretch(folder: Path, split: Split, name: str, start: float, stop: float) -> Recording:
    system = one_joint(split.system)
    channels = [(c.name, c.unit, c.kind) for c in (system.command, *system.measurements)]
    recording = read_log(folder / name, split.mapping, split.system, channels=channels).between(start, stop)
    # A measured torque is a sample in the middle of the time that it stands for, not a command that
    # begins to hold at its stamp.
    torque = recording.channels[system.command.name]
    centred = replace(torque, t=torque.t - 0.5 * np.median(np.diff(torque.t)))
    return replace(recording, channels={**recording.channels, system.command.name: centred})


def main(arguments: Sequence[str] | None = None, write: Callable[[str], object] = sys.stdout.write) -> int:
    """Run one study and print its figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, help="folder that holds one folder per log")
    parser.add_argument("--log", choices=sorted(STUDIES), required=True, help="which study")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--out", type=Path, help="also write the report into this new folder")
    args = parser.parse_args(arguments)
    began = time.perf_counter()
    try:
        diagnosis = run_study(args.data / args.log, STUDIES[args.log])
    except LogError as error:
        sys.stderr.write(f"real_logs: {error}\n")
        return 2
    figures = summary(diagnosis, time.perf_counter() - began)
    if args.out:
        write_report(diagnosis, args.out)
    lines = [json.dumps(figures)] if args.json else [f"{name}: {value}" for name, value in figures.items()]
    write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
