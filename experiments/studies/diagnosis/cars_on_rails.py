"""Study: cars on rails whose friction differs between directions, and with a force along the rail that no model has.

python -m experiments.studies.diagnosis.cars_on_rails names --out names.csv --seed 42000
python -m experiments.studies.diagnosis.cars_on_rails estimates --out estimates.csv --seed 43000 --units 20

``names`` diagnoses one-joint units with one or two known effects, with ``asymmetric_viscous`` in the catalogue and
without. ``estimates`` fits cars with the causes that they have, under independent and under correlated errors, and
simulates another motion of the same car with both.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.verdict.under_colour import fit_under_colour
from deepkoco.fit import Noise, cut_windows, moving
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.prior import Prior
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, System, make_system
from tests.oracle.slide import Car, Unit, log_of
from tests.oracle.unit import hidden_log

NEW = "asymmetric_viscous"
TRIED = (
    *(
        "viscous",
        "coulomb",
        "stribeck",
        "quadratic",
        "load_friction",
        NEW,
        "torque_bias",
        "asymmetry",
        "gain",
    ),
    *("gain_curve", "dead_zone", "saturation", "spring", "lag", "actuation_delay", "rate_limit"),
)
DRY, BIAS, ONE_WAY = (
    {"coulomb": {"torque": 0.04}},
    {"torque_bias": {"effort": 0.015}},
    {"asymmetry": {"share": 0.04}},
)
# The rod pendulum rubs little: friction that differs between directions would drive it, so it must not be named there.
PENDULUMS: tuple[tuple[str, dict[str, dict[str, float]]], ...] = (
    ("steps", {}),
    ("chirp", {}),
    ("steps", {"viscous": {"change": 0.25}}),
    ("chirp", DRY),
    ("steps", {"stribeck": {"coulomb": 0.005, "breakaway": 0.12, "speed": 0.7}}),
    ("steps", BIAS),
    ("chirp", BIAS),
    ("steps", {"asymmetry": {"share": 0.05}}),
    ("chirp", {"asymmetry": {"share": 0.03}}),
    ("steps", {"quadratic": {"drag": 0.004}}),
    ("steps", {NEW: {"difference": 0.05}}),
    ("chirp", {NEW: {"difference": -0.03}}),
    ("chirp", DRY | BIAS),
    ("steps", DRY | ONE_WAY),
    ("steps", DRY | {NEW: {"difference": 0.05}}),
)
CARS: tuple[dict[str, float], ...] = (
    {},
    {"offset": 2.5},
    {"asymmetry": 0.06},
    {"uneven": 60.0},
    {"offset": 2.5, "ripple": 1.0},
    {"asymmetry": 0.06, "ripple": 1.0},
    {"uneven": 60.0, "ripple": 1.0},
    {"ripple": 1.0},
)
SECONDS, WINDOW = 18.0, 1.5
OF_CAR = {"mass": "mass", "viscous": "viscous", "coulomb.torque": "dry", f"{NEW}.difference": "uneven"}


def cases(seed: int) -> Iterator[tuple[str, int, Recording, System, float | None]]:
    """What is hidden, the seed, a log of it, the simulation and the length of a window [s]."""
    for k, (drive, hidden) in enumerate(PENDULUMS):
        log = hidden_log("rod_pendulum", hidden, drive, seed + k, 20.0)
        yield f"rod_pendulum {drive} {json.dumps(hidden)}", seed + k, log, make_system("rod_pendulum"), None
    for k, own in enumerate(CARS, start=len(PENDULUMS)):
        rng = np.random.default_rng([seed, k])
        unit = Unit(float(rng.uniform(85.0, 120.0)), float(rng.uniform(150.0, 260.0)), 14.0, **own)
        log = log_of(unit, seed + k, SECONDS)
        yield f"car {json.dumps({'dry': 14.0, **own})} {unit.mass:.1f} kg", seed + k, log, Car(), WINDOW


def names(seed: int) -> Iterator[dict[str, Any]]:
    """One row for each case, without and with the entry in the catalogue."""
    for what, own, log, system, window in cases(seed):
        for entry in (False, True):
            began = time.process_time()
            only = [n for n in TRIED if entry or n != NEW]
            found = diagnose([log], system, only=only, window=window, seed=own)
            named = [c for c in found.causes if c.name != "unknown"]
            yield {
                "case": what,
                "seed": own,
                "entry_in_catalogue": int(entry),
                "verdict": found.verdict,
                "named": " + ".join(c.name for c in named),
                "delta_bic": " + ".join(f"{c.delta_bic:.1f}" for c in named),
                "parameters": json.dumps(
                    {n: round(e.value, 4) for c in named for n, e in c.parameters.items()}
                ),
                "chi2_per_sample": round(found.chi2_after, 3),
                "cpu_s": round(time.process_time() - began, 1),
            }


def estimates(seed: int, units: int) -> Iterator[dict[str, Any]]:
    """One row for each parameter of each car."""
    system, known = Car(), catalogue(Car())
    causes = [known["coulomb"], known[NEW]]
    for own in range(seed, seed + units):
        rng = np.random.default_rng(own)
        drawn = [
            float(rng.uniform(*span)) for span in ((85.0, 120.0), (150.0, 260.0), (10.0, 20.0), (-70.0, 70.0))
        ]
        mass, viscous, dry, uneven = drawn
        unit = Unit(mass, viscous, dry, uneven=uneven, ripple=float(rng.choice([0.5, 1.0, 2.0])))
        windows = _windows(log_of(unit, own, SECONDS))
        model = ExtendedSystem(system, ("coulomb", NEW), {"coulomb.torque": 15.0})
        start = baseline_from(model, windows)
        # Wide priors: what is compared is what the log says.
        prior = Prior.of([replace(p, prior_sd=10.0 * p.prior_sd) for p in model.parameters])
        start = replace(start, prior=prior)
        problem = FitProblem(start.system, windows)
        fit = problem.fit([Trial("independent", prior.names, prior, start.values)], 60)[0]
        coloured = fit_under_colour(problem, start, causes, fit)
        assert coloured is not None
        other = FitProblem(start.system, _windows(log_of(unit, own, SECONDS, motion=own + 9000)))
        errors = [_error(p, f.values) for p in (problem, other) for f in (fit, coloured)]
        deflation = dispersion(fit, windows).deflation
        for name, attribute in OF_CAR.items():
            i, true = fit.free.index(name), float(getattr(unit, attribute))
            reach = 1.96 * float(np.sqrt(fit.covariance[i, i] * deflation))
            both = sorted((fit.values[name], coloured.values[name]))
            yield {
                "seed": own,
                "ripple_n": unit.ripple,
                "parameter": name,
                "true": true,
                "independent": fit.values[name],
                "correlated": coloured.values[name],
                "half_width": reach,
                "own_interval_holds": int(abs(fit.values[name] - true) <= reach),
                "both_hold": int(both[0] - reach <= true <= both[1] + reach),
                "same_motion_mm": errors[0],
                "same_motion_correlated_mm": errors[1],
                "other_motion_mm": errors[2],
                "other_motion_correlated_mm": errors[3],
            }


def _windows(log: Recording) -> Windows:
    windows = cut_windows([log], Car(), WINDOW, (Noise(1e-5, 0.01),), cover=True)
    return windows.take(moving(windows))


def _error(problem: FitProblem, values: Any) -> float:
    """Root mean square error of the simulation [mm]; only initial states are fitted."""
    error = problem.evaluate(values).residual.numpy() * 1e-5
    return 1e3 * float(np.sqrt((error[problem.windows.valid.numpy()] ** 2).mean()))


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a table, row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("names", "estimates"))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--units", type=int, default=20, help="cars of estimates")
    args = parser.parse_args(arguments)
    rows = names(args.seed) if args.what == "names" else estimates(args.seed, args.units)
    with args.out.open("w") as file:
        writer = None
        for row in rows:
            if writer is None:
                writer = csv.DictWriter(file, list(row), lineterminator="\n")
                writer.writeheader()
            writer.writerow({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in row.items()})
            file.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
