"""Which experiment would settle what a log leaves open: computed for the unit and the sizes that the log shows."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import CAUSES
from deepkoco.diagnose.evidence.selection import Ranking
from deepkoco.diagnose.experiment_design.design import ALIKE, SETTLED, TRAINED, chance_of, smallest_pair
from deepkoco.diagnose.experiment_design.doses import Dose
from deepkoco.diagnose.experiment_design.experiment_setup import SHORTEST, Stage, feasible_seconds, make_stage
from deepkoco.diagnose.experiment_design.log_at_hand import LogAtHand
from deepkoco.diagnose.experiment_design.search import Scan, scan
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import ExtendedSystem, System

SECONDS = 10.0  # length of the experiments that are compared
TRIED = 6  # sequences of each family
SEEN = 1.0  # likelihood ratio against the refit, below which a cause shows too little to be compared
MOST = 5  # causes of a class that are compared
FEW_LEVELS = 3


def not_fitted(names: Sequence[str]) -> tuple[str, ...]:
    """A sentence on what could not be fitted, because the simulation diverges there."""
    if not names:
        return ()
    return (
        f"Could not be fitted: {_listed(names)}. The simulation diverges there. Check that the logs are of this "
        "system and of this unit, or give shorter windows.",
    )


def always_there(names: Sequence[str]) -> tuple[str, ...]:
    """A sentence on causes that are part of the unit, as far as its healthy logs can tell."""
    if not names:
        return ()
    return (
        f"The healthy logs allow {_listed(names)} as this log shows it: taken for part of the unit, and not for what "
        "went wrong. A healthy log under the same commands would tell.",
    )


def class_advice(
    system: System,
    start: Baseline,
    windows: Windows,
    steps: Sequence[tuple[Ranking, tuple[str, ...]]],
    logs: Sequence[str],
    seed: int,
) -> tuple[str, ...]:
    """One sentence or two for every class of more than one cause.

    Args:
        system: The simulation that was diagnosed.
        start: The baseline.
        windows: Training windows.
        steps: Ranking and class of every cause that was accepted.
        logs: Files that were diagnosed.
        seed: Of the sequences that are tried.
    """
    result: list[str] = []
    for ranking, members in steps:
        if len(members) > 1:
            result += _advise(system, start, windows, ranking, members, logs, seed)
    return tuple(result)


def level_advice(windows: Windows, system: System) -> tuple[str, ...]:
    """A warning for every command that takes a few values only."""
    advice = []
    for k, channel in enumerate(
        system.commands[: len(system.command_joints)]
    ):  # the others switch or set modes
        command = np.concatenate([c.column(k) for c in windows.commands]) if windows.commands else np.zeros(0)
        levels = np.unique(np.round(command / max(np.ptp(command), 1e-12), 2)) if len(command) else command
        if 0 < len(levels) <= FEW_LEVELS:
            advice.append(
                f"The commands of {channel.name} take only {len(levels)} levels ({channel.unit}): gain, payload, dead "
                "zone and saturation look alike then. Record steps of many levels or a chirp."
            )
    return tuple(advice)


def _advise(
    system: System,
    start: Baseline,
    windows: Windows,
    ranking: Ranking,
    members: tuple[str, ...],
    logs: Sequence[str],
    seed: int,
) -> list[str]:
    problem = FitProblem(start.system, windows)
    problem, reference = problem.as_fitted(problem.recentred(ranking.reference))
    windows = problem.windows
    doses = _doses(ranking, start, members)
    compared = list(doses)
    result = []
    others = [n for n in members if n not in compared]
    if others or len(compared) < 2:
        result.append(f"To tell apart {_listed(members)}: {_by_hand(others or members)}")
    if len(compared) < 2:
        return result
    listed = list(doses.values())
    stage = make_stage(
        system, feasible_seconds(system, max(SECONDS, SHORTEST * windows.length)), noise=windows.noise
    )
    stage = replace(
        stage, start=replace(start, values={**reference.values, "event.torque": 0.0}), window=windows.length
    )
    units = [dose.on(stage.start.values) for dose in listed]
    scans = scan(stage, listed, units, np.random.default_rng([seed, 23]), TRIED)
    share = np.max([s.separation.share for s in scans], axis=0)
    shown = np.concatenate([s.separation.seen for s in scans]).max(0)
    apart, twins = list(range(len(compared))), []
    for a, b in combinations(range(len(compared)), 2):
        if share[a, b] < ALIKE and min(shown[a], shown[b]) > SEEN and a in apart and b in apart:
            twins += [n for n in (compared[a], compared[b]) if n not in twins]
            apart.remove(b)
    if twins:
        result.append(f"No command tells {_listed(twins)} apart, whatever is played. {_by_hand(twins)}")
    if len(apart) > 1:
        names = [compared[i] for i in apart]
        at_hand = LogAtHand(stage.start, replace(windows, state=reference.state), reference, {})
        now = at_hand.separation([listed[i] for i in apart])
        result.append(_sentence(system, stage, names, apart, scans, smallest_pair(now.ratio.sum(0)), logs))
    return result


def _doses(ranking: Ranking, start: Baseline, members: Sequence[str]) -> dict[str, Dose]:
    """The causes of a class at their fitted sizes; left out is what commands cannot bring out, or stays at null."""
    fits = {c.cause.name: c for c in ranking.candidates if c.fit is not ranking.reference}
    result = {}
    for name in members:
        if name in fits and fits[name].cause.free and fits[name].cause.effect != "event":
            values = {p: fits[name].fit.values[p] for p in fits[name].cause.free}
            if any(values[p] != start.values[p] for p in values):
                result[name] = Dose(fits[name].cause, values)
    return dict(list(result.items())[:MOST])


def _sentence(
    system: System,
    stage: Stage,
    names: Sequence[str],
    index: Sequence[int],
    scans: Sequence[Scan],
    now: float,
    logs: Sequence[str],
) -> str:
    pick = np.ix_(index, index)
    off = ~np.eye(len(index), dtype=bool)
    best, family = 0.0, scans[0].family
    for found in scans:
        kept = found.separation.ratio[found.allowed]
        if len(kept):
            ratio = float(max(TRAINED * r[pick][off].min() for r in kept))
            best, family = (ratio, found.family) if ratio > best else (best, family)
    seconds = stage.frame.seconds
    command = ["deepkoco", "design-experiment", *_origin(system), "--distinguish", *names]
    command += ["--recording", *logs] if logs else []
    text = f"To tell apart {_listed(names)}: "
    if best >= SETTLED:
        text += (
            f"{seconds:.3g} s of {family.text} would, with an expected likelihood ratio of {best:.3g} (this log: "
            f"{now:.2g}; {SETTLED:.0f} is enough)."
        )
    else:
        needed = seconds * SETTLED / max(best, 1e-9)
        text += (
            f"the best of what was tried, {family.text}, gives an expected likelihood ratio of {best:.2g} in "
            f"{seconds:.3g} s (this log: {now:.2g}; {SETTLED:.0f} is enough), a chance of "
            f"{100 * chance_of(best):.0f} %; "
        )
        text += f"about {needed:.2g} s would be needed. " if needed < 600.0 else "commands hardly can. "
        text += _by_hand(names)
    return f"{text} The best sequence: {shlex.join(command)}"


def _origin(system: System) -> list[str]:
    if isinstance(system, ExtendedSystem):
        return ["--model", str(system.source or "model.yaml")]
    return ["--system", system.name]


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]


def _by_hand(names: Sequence[str]) -> str:
    """What the catalogue says about telling causes from their neighbours."""
    kinds = [n.split("(")[0] for n in names]
    return " ".join(dict.fromkeys(CAUSES[k].advice for k in kinds if k in CAUSES))
