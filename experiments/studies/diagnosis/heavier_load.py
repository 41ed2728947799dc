"""Study: a servo on a pendulum carries two or three times the load of its healthy logs; the load shall be named first.

python -m experiments.studies.diagnosis.heavier_load --out FILE.csv [--seeds 42000 42001] [--benches go1 xl330]

Each case has three healthy logs of six seconds and one log with the heavier load. Parameters of the unit are drawn
within their priors, and friction and motor differ by 1 % from log to log. The unit (`tests.oracle.servo_unit`) shares
no equation of friction with the package. A control has the usual load. A study that is started again goes on.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from deepkoco.diagnose import diagnose
from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems import System, make_system
from experiments.studies.diagnosis.servo_bench import SHARE_PER_GAIN, VOLTS, Xl330Bench
from tests.oracle.servo_unit import GRAVITY, MOTIONS, ServoUnit, log_of

COLUMNS: tuple[str, ...] = (
    "bench", "seed", "motion", "load", "verdict", "named", "class", "payload_kg", "low", "high", "true_kg",
    "chi2_refit", "chi2_final", "cpu_s",
)  # fmt: skip
VARIES = 0.01  # standard deviation of friction and motor from log to log, as a share of each
GAIN, LIGHT = 400.0, 0.15  # of the small servo; its load [kg] is one that it can lift three times over
BENCHES = ("go1", "xl330")


class LightBench(Xl330Bench):
    """The bench of a small servo with a load that it can lift three times over."""

    mass = LIGHT

    def __init__(self) -> None:
        super().__init__()
        self.parameters = tuple(
            replace(p, value=GAIN) if p.name == "servo_gain" else p for p in self.parameters
        )


def bench_of(name: str, rng: np.random.Generator) -> tuple[System, ServoUnit]:
    """Return the system as given, and a unit whose parameters are drawn within its priors."""
    draw = rng.standard_normal
    if name == "go1":
        mass = (0.0574 + 0.01 * draw()) / (GRAVITY * 0.15)
        rotor = 0.011 - mass * 0.15**2 + 0.001 * draw()
        unit = ServoUnit(
            10.0 + 0.5 * draw(), 0.3 + 0.02 * draw(), 1e3, mass, 0.15, rotor, abs(0.03 + 0.01 * draw()),
            0.06 + 0.02 * rng.random(), 0.05, 0.03, 0.01 * draw(),
        )  # fmt: skip
        return make_system("servo_pendulum"), unit
    constant, resistance = 0.35 + 0.03 * draw(), 3.4 + 0.3 * draw()
    stall = VOLTS * constant / resistance
    unit = ServoUnit(
        SHARE_PER_GAIN * GAIN * stall, constant**2 / resistance, stall, LIGHT, 0.1,
        1e-3 * (1.0 + 0.3 * rng.random()), 0.006, 0.015, 0.15, 0.01, 0.01 * draw(),
    )  # fmt: skip
    return LightBench(), unit


def row(bench: str, seed: int, load: float) -> list[str]:
    """Diagnose one case; return its row."""
    rng = np.random.default_rng(seed)
    system, unit = bench_of(bench, rng)
    # The drive is off for most of the last motion, so it is not asked about.
    held = MOTIONS[seed % 3]
    healthy = [log_of(unit.today(rng, VARIES), m, 100 * seed + i) for i, m in enumerate(MOTIONS) if m != held]
    today = replace(unit.today(rng, VARIES), mass=load * unit.mass)
    log = log_of(today, held, 100 * seed + 50)
    began = time.process_time()
    found = diagnose([log], system, healthy=healthy)
    seconds = time.process_time() - began
    sizes = [e for c in found.causes for n, e in c.parameters.items() if n == "payload.mass"]
    size = [f"{x:.4f}" for x in (sizes[0].value, sizes[0].low, sizes[0].high)] if sizes else ["", "", ""]
    first = " ".join(found.causes[0].members) if found.causes else ""
    chi2 = (f"{x:.3f}" for x in (found.chi2_before, found.chi2_after))
    true = f"{(load - 1.0) * unit.mass:.4f}"
    return [
        bench, str(seed), held, f"{load:g}", found.verdict, " ".join(found.names), first, *size, true, *chi2,
        f"{seconds:.1f}",
    ]  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all cases; the file is written after each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(42000, 42005)))
    parser.add_argument("--benches", nargs="+", choices=BENCHES, default=list(BENCHES))
    parser.add_argument(
        "--loads", type=float, nargs="+", default=[2.0, 3.0, 1.0], help="times the usual load"
    )
    args = parser.parse_args(arguments)
    rows = list(csv.reader(args.out.read_text().splitlines())) if args.out.exists() else [list(COLUMNS)]
    if rows[0] != list(COLUMNS):
        parser.error(f"{args.out} is no table of this study; choose another file")
    done = {(r[0], r[1], r[3]) for r in rows[1:]}
    for seed in args.seeds:
        for bench in args.benches:
            for load in args.loads:
                if (bench, str(seed), f"{load:g}") in done:
                    continue
                rows.append(row(bench, seed, load))
                sys.stdout.write(",".join(rows[-1]) + "\n")
                sys.stdout.flush()
                write_whole_text(args.out, "".join(",".join(r) + "\n" for r in rows))


if __name__ == "__main__":
    main()
