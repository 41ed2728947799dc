"""Study: is a servo falsely named a cause, where what it has is in no catalogue, or named rightly, where it is in it?

python -m experiments.studies.diagnosis.servo_odd --out FILE.csv [--seeds 43000 43001] [--hidden play load ...]

Each case has three healthy logs of six seconds and one log with a hidden effect, on the benches of the study
`heavier_load`: friction and motor differ by 1 % from log to log, and the friction of the unit is not the package's. Odd
effects (`tests.oracle.odd_servos`) are in no catalogue; the others are. A study that is started again goes on.
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
from experiments.studies.diagnosis.heavier_load import BENCHES, VARIES, bench_of
from tests.oracle.odd_servos import ODD, OddServo
from tests.oracle.servo_unit import GRAVITY, MOTIONS, ServoUnit

COLUMNS: tuple[str, ...] = (
    "bench", "seed", "motion", "hidden", "verdict", "named", "classes", "best", "chi2_refit", "chi2_final", "gain",
    "why", "cpu_s",
)  # fmt: skip
USUAL = ("load", "stiffness", "viscous", "dry", "zero", "gear")


def with_usual(unit: ServoUnit, hidden: str) -> ServoUnit:
    """The unit with an effect that the catalogue has, or with none."""
    weight = unit.mass * GRAVITY * unit.length
    changes = {
        "load": {"mass": 1.5 * unit.mass},
        "stiffness": {"stiffness": 0.7 * unit.stiffness},
        "viscous": {"viscous": unit.viscous + 0.1 * weight},
        "dry": {"dry": unit.dry + 0.3 * weight},
        "zero": {"zero": unit.zero + 0.1},
        "gear": {"share": unit.share + 0.3},
    }
    return replace(unit, **changes.get(hidden, {}))


def row(bench: str, seed: int, hidden: str) -> list[str]:
    """Diagnose one case; return its row."""
    rng = np.random.default_rng(seed)
    system, unit = bench_of(bench, rng)
    held = MOTIONS[seed % 3]
    healthy = [
        OddServo(unit.today(rng, VARIES)).log(m, 100 * seed + i) for i, m in enumerate(MOTIONS) if m != held
    ]
    today = with_usual(unit.today(rng, VARIES), hidden)
    log = OddServo(today, hidden if hidden in ODD else "").log(held, 100 * seed + 50)
    began = time.process_time()
    found = diagnose([log], system, healthy=healthy)
    seconds = time.process_time() - began
    gain = "" if found.gain is None else f"{found.gain.reduction:.2f}"
    return [
        bench, str(seed), held, hidden, found.verdict, " ".join(found.names),
        " | ".join(" ".join(c.members) for c in found.causes),
        " ".join(f"{c.name}:{c.delta_bic:.0f}" for c in found.candidates[:3]),
        f"{found.chi2_before:.3f}", f"{found.chi2_after:.3f}", gain,
        " ".join(found.unexplained["doubts"]), f"{seconds:.1f}",
    ]  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all cases; the file is written after each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[43000])
    parser.add_argument("--benches", nargs="+", choices=BENCHES, default=list(BENCHES))
    parser.add_argument("--hidden", nargs="+", choices=(*ODD, *USUAL, "nothing"), default=[*ODD, *USUAL])
    args = parser.parse_args(arguments)
    rows = list(csv.reader(args.out.read_text().splitlines())) if args.out.exists() else [list(COLUMNS)]
    if rows[0] != list(COLUMNS):
        parser.error(f"{args.out} is no table of this study; choose another file")
    done = {(r[0], r[1], r[3]) for r in rows[1:]}
    for seed in args.seeds:
        for hidden in args.hidden:
            for bench in args.benches:
                if (bench, str(seed), hidden) in done:
                    continue
                rows.append(row(bench, seed, hidden))
                sys.stdout.write(" ; ".join(rows[-1]) + "\n")
                sys.stdout.flush()
                with_commas = "\n".join(",".join(f'"{x}"' if "," in x else x for x in r) for r in rows)
                write_whole_text(args.out, with_commas + "\n")


if __name__ == "__main__":
    main()
