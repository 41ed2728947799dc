"""Study: hide an effect in a unit, record it in simulated time, and see whether the diagnosis finds it.

    python -m experiments.hidden_effects --out results/diagnose --controls 60 --strengths 0.3 1 3 --seed 1000

The unit is another implementation of the machine (own physics, true sticking, own noise); its parameters
are drawn within the priors of the system. The strength of an effect is ES: the root mean square of what
the refitted baseline cannot explain, in units of the sensor noise. A case is scaled to its nominal
strength by measuring ES on a noise-free log of the same unit.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.diagnose import CAUSES, diagnose
from deepkoco.diagnose.baseline import refit, start_from
from deepkoco.graph.recording import Recording
from deepkoco.identify import Noise, cut_windows, moving, window_length
from deepkoco.systems import JointSystem, one_joint
from deepkoco.unit import UnitSpecError, make_unit
from deepkoco.unit.record import record

SYSTEMS = ("rod_pendulum", "pendulum")
EXCITATIONS = ("steps", "chirp", "prbs")
Hidden = Mapping[str, Mapping[str, Any]]

# One dose x of every effect: system scale (typical joint torque [N m]), largest command -> what is hidden.
# Doses are such that x = 1 is visible on both pendulums.
DOSES: dict[str, Callable[[float, float, float], Hidden]] = {
    "actuation_delay": lambda x, torque, command: {"actuation_delay": {"delay": 0.004 * x}},
    "sensing_delay": lambda x, torque, command: {"sensing_delay": {"delay": 0.004 * x}},
    "lag": lambda x, torque, command: {"lag": {"time_constant": 0.004 * x}},
    "viscous": lambda x, torque, command: {"viscous": {"change": 0.01 * x * torque * _period(torque)}},
    "coulomb": lambda x, torque, command: {"coulomb": {"torque": 0.01 * x * torque}},
    "stribeck": lambda x, torque, command: {
        "stribeck": {
            "coulomb": 0.002 * x * torque,
            "breakaway": 0.03 * x * torque,
            "speed": 0.2 / _period(torque),
        }
    },
    "quadratic": lambda x, torque, command: {
        "quadratic": {"drag": 0.003 * x * torque * _period(torque) ** 2}
    },
    "gain": lambda x, torque, command: {"gain": {"factor": 1.0 / (1.0 + 0.1 * x)}},
    "torque_bias": lambda x, torque, command: {"torque_bias": {"effort": 0.01 * x * command}},
    "dead_zone": lambda x, torque, command: {"dead_zone": {"width": 0.02 * x * command}},
    "saturation": lambda x, torque, command: {"saturation": {"limit": command / (1.0 + 0.1 * x)}},
    "payload": lambda x, torque, command: {"payload": {"mass": 0.03 * x * torque / 9.81}},
    "sensor_bias": lambda x, torque, command: {"sensor_bias": {"angle": 0.01 * x}},
    "sensor_scale": lambda x, torque, command: {"sensor_scale": {"factor": 1.0 + 0.004 * x}},
    "event": lambda x, torque, command: {
        "event": {"torque": 0.1 * x * torque, "start": 7.3, "duration": 0.2}
    },
}


def _period(torque: float) -> float:
    """Time scale of the two pendulums by their torque scale [s]: the small one is faster."""
    return 0.3 if torque > 1.0 else 0.1


def unit_log(
    system: str, hidden: Hidden, excitation: str, seed: int, seconds: float = 30.0, noisy: bool = True
) -> Recording:
    """Log of a unit with parameters drawn within the system's priors.

    Args:
        system: Name of the system.
        hidden: Effects and their parameters.
        excitation: Name of the excitation.
        seed: Seed of parameters, excitation and noise.
        seconds: Length of the log [s].
        noisy: Whether the sensors have noise.
    """
    base = one_joint(system)
    rng = np.random.default_rng(seed)
    parameters = {}
    for p in base.parameters:
        # Within two standard deviations: beyond that the data sheet would be wrong.
        shift = float(np.clip(rng.standard_normal(), -2.0, 2.0))
        parameters[p.name] = float(np.clip(p.value + p.prior_sd * shift, p.low, p.high))
    sensor: dict[str, Any] = {"rate_hz": 100.0}
    if not noisy:
        sensor["noise_sd"] = {c.name: 0.0 for c in base.measurements}
    spec = make_unit(system, effects=hidden, parameters=parameters, sensor=sensor, seed=seed)
    return record(spec, excitation, seconds, clock="simulated", seed=seed)


def unexplained(recording: Recording, system: str) -> tuple[float, int]:
    """Cost that the refitted baseline leaves (its distance from its priors included), and samples."""
    base = one_joint(system)
    assert isinstance(base, JointSystem)
    noise = tuple(Noise(c.noise_sd, 0.0) for c in base.measurements)
    windows = cut_windows([recording], base, window_length(base), noise)
    windows = windows.take(moving(windows))
    return refit(start_from(base, windows), windows).cost, windows.samples


def strength(system: str, hidden: Hidden, excitation: str, seed: int, seconds: float = 30.0) -> float:
    """ES of what is hidden, on noise-free logs: root mean square in nominal noise standard deviations.

    It is measured against the same unit without the effect, whose parameters are off nominal too.
    """
    cost, samples = unexplained(unit_log(system, hidden, excitation, seed, seconds, noisy=False), system)
    healthy, other = unexplained(unit_log(system, {}, excitation, seed, seconds, noisy=False), system)
    return math.sqrt(max(cost / samples - healthy / other, 0.0))


def dosed(
    cause: str, system: str, excitation: str, seed: int, wanted: float, seconds: float
) -> tuple[Hidden, float]:
    """Dose of a cause at which ES is about what is wanted, and the ES that it really has."""
    base = one_joint(system)
    dose, found = 1.0, 0.0
    hidden: Hidden = {}
    for _ in range(5):
        asked = DOSES[cause](dose, base.load_scale, base.command.high)
        try:
            found = strength(system, asked, excitation, seed, seconds)
        except UnitSpecError:
            break  # the unit cannot carry that much; what was found before is the most
        hidden = asked
        if 0.8 * wanted < found < 1.25 * wanted:
            break
        dose *= float(np.clip(wanted / max(found, 1e-3), 0.05, 8.0))
    return hidden, found


def study(
    strengths: Sequence[float], controls: int, seed: int, seconds: float, progress: Callable[[str], object]
) -> Iterator[dict[str, Any]]:
    """One row per case: what was hidden, how strong, what was named."""
    cases: list[tuple[str, float]] = [("", 0.0)] * controls
    cases += [(cause, wanted) for wanted in strengths for cause in CAUSES]
    for index, (cause, wanted) in enumerate(cases):
        system = SYSTEMS[index % len(SYSTEMS)]
        excitation = EXCITATIONS[(index // len(SYSTEMS)) % len(EXCITATIONS)]
        own = seed + index
        hidden, found = dosed(cause, system, excitation, own, wanted, seconds) if cause else ({}, 0.0)
        began = time.process_time()
        result = diagnose([unit_log(system, hidden, excitation, own, seconds)], system, seed=own)
        members = result.causes[0].members if result.causes else ()
        row = {
            "seed": own,
            "system": system,
            "excitation": excitation,
            "hidden": cause or "nothing",
            "ES": round(found, 3),
            "verdict": result.verdict,
            "first": members[0] if members else "",
            "class": " ".join(members),
            "named": " ".join(result.names),
            "in_class": cause in members,
            "cpu_s": round(time.process_time() - began, 2),
        }
        progress(f"{index + 1}/{len(cases)} {row}\n")
        yield row


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and write its table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for hidden_effects.csv")
    parser.add_argument("--controls", type=int, default=60, help="logs in which nothing is hidden")
    parser.add_argument("--strengths", type=float, nargs="+", default=[0.3, 1.0, 3.0], help="ES of the cases")
    parser.add_argument("--seconds", type=float, default=30.0, help="length of a log [s]")
    parser.add_argument("--seed", type=int, default=1000, help="seed of the first case")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / "hidden_effects.csv"
    if path.exists():
        parser.error(f"{path} exists; choose another folder or move it away")
    with path.open("w", newline="") as file:
        writer: csv.DictWriter | None = None
        # Row by row: a study that is stopped keeps what it has.
        for row in study(args.strengths, args.controls, args.seed, args.seconds, sys.stderr.write):
            if writer is None:
                writer = csv.DictWriter(file, row)
                writer.writeheader()
            writer.writerow(row)
            file.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
