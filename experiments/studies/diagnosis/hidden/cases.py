"""Cases of the study: what is hidden in which log, and what a diagnosis makes of it."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.logs.recording import Recording
from deepkoco.systems import make_system
from tests.oracle.doses import FLOOR, dosed, effect_names, outside, outside_names, scaled
from tests.oracle.unit import Hidden, hidden_log

CONDITIONS = ("clean", "floor", "runs", "bang-bang")
CONTROL, SINGLE, PAIR = 0.3, 0.5, 0.1  # shares of the cases; the rest is outside the catalogue
WEAKEST, STRONGEST = 0.1, 3.0  # ES
OPEN = ("steps", "chirp", "closed-loop")
VARIES = 0.02  # standard deviation of every parameter from run to run, as a share, in the condition "runs"


@dataclass(frozen=True)
class Case:
    """One log of the study.

    Attributes:
        index: Number in the study.
        seed: Seed of unit, excitation and noise.
        kind: "control", "single", "pair" or "outside".
        names: Effects that are hidden.
        wanted: Strength ES that each shall have.
        excitation: Name of the excitation.
    """

    index: int
    seed: int
    kind: str
    names: tuple[str, ...]
    wanted: float
    excitation: str


def make_case(index: int, seed: int, system: str, condition: str) -> Case:
    """Draw a case; the same numbers give the same case, whatever was drawn before."""
    rng = np.random.default_rng([seed, index, 7])
    share = rng.random()
    names = effect_names(system)
    excitation = "bang-bang" if condition == "bang-bang" else str(rng.choice(OPEN))
    wanted = float(math.exp(rng.uniform(math.log(WEAKEST), math.log(STRONGEST))))
    if share < CONTROL:
        kind, chosen, wanted = "control", (), 0.0
    elif share < CONTROL + SINGLE:
        kind, chosen = "single", (str(rng.choice(names)),)
    elif share < CONTROL + SINGLE + PAIR:
        kind, chosen = "pair", tuple(str(n) for n in rng.choice(names, 2, replace=False))
        wanted = max(wanted, 0.5)
    else:
        kind, chosen = "outside", (str(rng.choice(outside_names(system))),)
        wanted = max(wanted, 0.7)
    return Case(index, seed + index, kind, chosen, wanted, excitation)


class Recorded(NamedTuple):
    """What a case gives to the diagnosis, and the truth about it.

    Attributes:
        log: Log to explain.
        healthy: Logs of the same unit in which nothing is wrong.
        hidden: Effects of the unit, the floor's included, with their parameters.
        strengths: ES of each effect of the case.
    """

    log: Recording
    healthy: list[Recording]
    hidden: dict[str, Mapping[str, float]]
    strengths: list[float]


def record_case(case: Case, system: str, condition: str, seconds: float) -> Recorded:
    """Hide the effects of a case at their strengths, and record the logs."""
    floor = small_effects(system) if condition in ("floor", "runs") else {}
    varies = VARIES if condition == "runs" else 0.0
    hidden: dict[str, Mapping[str, float]] = dict(floor)
    strengths = []
    for name in case.names:
        make = outside if case.kind == "outside" else dosed
        added, found = scaled(
            lambda x, make=make, name=name: make(name, system, x) if x else {},
            system,
            case.excitation,
            case.seed,
            seconds,
            case.wanted,
        )
        hidden = _merged(hidden, added)
        strengths.append(found)
    log = hidden_log(system, hidden, case.excitation, case.seed, seconds, varies=varies)
    healthy = []
    if condition == "floor":
        # The same unit on a day on which nothing is wrong: same parameters, another excitation and noise.
        healthy = [hidden_log(system, floor, "chirp", case.seed, seconds)]
    if condition == "runs":
        healthy = [
            hidden_log(system, floor, drive, case.seed, seconds, take=k, varies=varies)
            for k, drive in enumerate(OPEN, start=1)
        ]
    return Recorded(log, healthy, hidden, strengths)


def run_case(case: Case, system: str, condition: str, seconds: float) -> dict[str, Any]:
    """Hide, record, diagnose; one row of the study, plain values only."""
    return judge(case, record_case(case, system, condition, seconds), system, condition)


def judge(case: Case, recorded: Recorded, system: str, condition: str) -> dict[str, Any]:
    """Diagnose a recorded case; one row of the study, plain values only."""
    log, healthy, hidden, strengths = recorded
    began = time.process_time()
    result = diagnose([log], system, healthy, seed=case.seed)
    spent = time.process_time() - began
    oracle = _oracle(case, result, log, system, healthy)
    return {
        "index": case.index,
        "seed": case.seed,
        "system": system,
        "condition": condition,
        "excitation": case.excitation,
        "kind": case.kind,
        "hidden": " + ".join(case.names),
        "ES": " + ".join(f"{x:.3f}" for x in strengths),
        "verdict": result.verdict,
        "classes": json.dumps([list(c.members) for c in result.causes]),
        "probabilities": json.dumps(stated(result)),
        "parameters": json.dumps(_estimates(result, hidden)),
        "chi2_before": round(result.chi2_before, 4),
        "chi2_after": round(result.chi2_after, 4),
        **_gains(result, oracle),
        "cpu_s": round(spent, 2),
    }


def stated(result: Diagnosis) -> list[dict[str, float]]:
    """The probabilities that a report states, for each place of a named cause, or for "nothing"."""
    places = [c.probabilities for c in result.causes] or [result.probabilities]
    return [{n: round(p, 4) for n, p in place.items()} for place in places if place]


def small_effects(system: str) -> dict[str, Mapping[str, float]]:
    """What every unit of the conditions "floor" and "runs" has, also when nothing is wrong."""
    physics = make_system(system)
    floor: dict[str, Mapping[str, float]] = {}
    for kind, dose in FLOOR:
        if kind == "load_friction" and not physics.dry_friction:
            continue
        floor |= dosed(kind if physics.joints == 1 else f"{kind}(joint 1)", system, dose)
    return floor


def _merged(a: Hidden, b: Hidden) -> dict[str, Mapping[str, float]]:
    """Both effects; where the floor has one already, the parameters of a dose add to what is there."""
    result = dict(a)
    for name, values in b.items():
        had = result.get(name)
        if had is None:
            result[name] = values
        elif name.startswith("gain") and "factor" in values:
            result[name] = {"factor": values["factor"] * had["factor"]}
        else:
            result[name] = {k: v + had.get(k, 0.0) for k, v in values.items()}
    return result


def _estimates(result: Diagnosis, hidden: Hidden) -> list[dict[str, float | str]]:
    """True value and interval of every parameter of a cause that was named exactly."""
    rows = []
    for cause in result.causes:
        for name, estimate in cause.parameters.items():
            true = hidden.get(cause.name, {}).get(name.rsplit(".", 1)[-1])
            if true is not None:
                row = {"name": name, "true": true, "value": estimate.value}
                rows.append({**row, "low": estimate.low, "high": estimate.high})
    return rows


def _oracle(
    case: Case, result: Diagnosis, log: Recording, system: str, healthy: Sequence[Recording]
) -> Diagnosis | None:
    """The same diagnosis by one who knows what is hidden: only the true causes are tried, and any gain counts."""
    if case.kind not in ("single", "pair") or result.gain is None or "event" in " ".join(case.names):
        return None
    return diagnose([log], system, healthy, seed=case.seed, detection=0.0, only=case.names)


def _gains(result: Diagnosis, oracle: Diagnosis | None) -> dict[str, float | str]:
    if result.gain is None:
        return {"gain": "", "oracle_gain": "", "against_given": ""}
    channel = result.gain.channels[0]
    best = oracle.gain.reduction if oracle is not None and oracle.gain is not None else None
    return {
        "gain": round(result.gain.reduction, 5),
        "oracle_gain": "" if best is None else round(best, 5),
        "against_given": round(channel.extended / max(channel.baseline, 1e-300), 5),
    }
