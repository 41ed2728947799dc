"""Benchmark: one fixed 30 s log, the whole catalogue, one core, with and without the report.

python -m experiments.diagnose_benchmark --json
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from deepkoco.diagnose import diagnose, write_report
from deepkoco.diagnose.causes import catalogue
from deepkoco.systems import make_system
from tests.oracle.unit import Hidden, hidden_log

SECONDS, SEED = 30.0, 11
FIXED: dict[str, Hidden] = {
    "rod_pendulum": {"coulomb": {"torque": 0.04}},
    "pendulum": {"lag": {"time_constant": 0.002}},
    "two_link_arm": {"coulomb(joint 2)": {"torque": 0.05}},
    "quadrotor_height": {"gain": {"factor": 0.9}},
}


def measure(system: str, healthy: bool, repeat: int) -> dict:
    """Seconds of a diagnosis and of its report: the least of several, wall clock and processor."""
    log = hidden_log(system, {} if healthy else FIXED[system], "steps", SEED, SECONDS)
    wall, processor, report = [], [], []
    for _ in range(repeat):
        began, worked = time.perf_counter(), time.process_time()
        result = diagnose([log], system)
        wall.append(time.perf_counter() - began)
        processor.append(time.process_time() - worked)
        with tempfile.TemporaryDirectory() as folder:
            began = time.perf_counter()
            write_report(result, Path(folder) / "report")
            report.append(time.perf_counter() - began)
    return {
        "system": system,
        "log_s": SECONDS,
        "hidden": "nothing" if healthy else next(iter(FIXED[system])),
        "verdict": result.verdict,
        "named": list(result.names),
        "causes_tried": len(catalogue(make_system(system))),
        "windows": result.windows,
        "diagnosis_s": round(min(wall), 3),
        "diagnosis_processor_s": round(min(processor), 3),
        "with_report_s": round(min(wall) + min(report), 3),
        "repeats": repeat,
    }


def main(arguments: Sequence[str] | None = None, write: Callable[[str], object] = sys.stdout.write) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--system", choices=sorted(FIXED), default="rod_pendulum")
    parser.add_argument("--healthy", action="store_true", help="a log in which nothing is hidden")
    parser.add_argument("--repeat", type=int, default=3, help="measurements, of which the least counts")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    if args.repeat < 1:
        parser.error(f"--repeat {args.repeat}: give 1 or more")
    figures = measure(args.system, args.healthy, args.repeat)
    lines = [json.dumps(figures)] if args.json else [f"{name}: {value}" for name, value in figures.items()]
    write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
