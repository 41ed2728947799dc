"""Advice: experiments that would distinguish the causes of a class, computed for the unit and the fitted sizes."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import CAUSES
from deepkoco.diagnose.evidence.ranking import Ranking
from deepkoco.diagnose.experiment_design.design import ALIKE, SETTLED, TRAINED, chance_of, smallest_pair
from deepkoco.diagnose.experiment_design.doses import Dose
from deepkoco.diagnose.experiment_design.experiment_setup import (
    SHORTEST,
    DesignError,
    Stage,
    feasible_seconds,
    make_stage,
)
from deepkoco.diagnose.experiment_design.log_at_hand import LogAtHand
from deepkoco.diagnose.experiment_design.search import Scan, scan
from deepkoco.diagnose.probability.answer import Answer
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.simulate.push import QUIET
from deepkoco.systems import ExtendedSystem, System
from deepkoco.systems.origins import origin_of, stored_origin

SECONDS = 10.0  # length of the experiments that are compared
SEQUENCES_PER_FAMILY = 6
MIN_LIKELIHOOD_RATIO = 1.0  # against the refit; a cause below it is too small to be compared
MAX_COMPARED = 5  # causes of a class that are compared
FEW_LEVELS = 3
POSSIBLE = 0.05  # probability from which a cause that is not named is listed


def not_fitted(names: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence that lists what could not be fitted because the simulation diverges."""
    if not names:
        return ()
    return (
        f"Could not be fitted: {_listed(names)}. The simulation diverges there. Check that the logs belong to this "
        "system and this unit, or give shorter windows.",
    )


def always_there(names: Sequence[str]) -> tuple[str, ...]:
    """Return advice about causes that the healthy logs are consistent with, and that therefore joined the baseline."""
    if not names:
        return ()
    return (
        f"The healthy logs are consistent with {_listed(names)} of the size that this log shows. It is therefore "
        "counted as part of the unit and not named. To test this, record a healthy log under the same commands.",
    )


def possible_advice(weights: Answer, least: float = POSSIBLE) -> tuple[str, ...]:
    """Return advice about causes that are not named, because nothing weighs more, and that are not excluded.

    Args:
        weights: Probabilities of the explanations.
        least: Probability from which a cause is listed.
    """
    found = [(name, p) for name, p in weights.causes.items() if name != "unknown" and p >= least]
    if not found:
        return ()
    told = _listed([f"{name} ({100.0 * p:.0f} %)" for name, p in found])
    return (
        f"Not excluded, by probability: {told}. Without healthy logs, a unit may differ from its model file by as much "
        "as this. Healthy logs of this unit, or the stated accuracy (prior_sd) of what is known better, tell more.",
    )


def class_advice(
    system: System,
    start: Baseline,
    windows: Windows,
    steps: Sequence[tuple[Ranking, tuple[str, ...]]],
    logs: Sequence[str],
    seed: int,
) -> tuple[str, ...]:
    """Return advice for every class of more than one cause.

    Args:
        system: The simulation that was diagnosed.
        start: The baseline.
        windows: Training windows.
        steps: Ranking and class of every cause that was accepted.
        logs: Files that were diagnosed.
        seed: Seed of the sequences that are tried.
    """
    result: list[str] = []
    for ranking, members in steps:
        if len(members) > 1:
            result += _advise(system, start, windows, ranking, members, logs, seed)
    return tuple(result)


def level_advice(windows: Windows, system: System) -> tuple[str, ...]:
    """Return a warning for every command that takes only a few values."""
    advice = []
    for k, channel in enumerate(
        system.commands[: len(system.command_joints)]
    ):  # the other commands switch or set modes
        command = np.concatenate([c.column(k) for c in windows.commands]) if windows.commands else np.zeros(0)
        if channel.default is not None and np.all(command == channel.default):
            continue  # no log shows it: nothing drives this joint
        levels = np.unique(np.round(command / max(np.ptp(command), 1e-12), 2)) if len(command) else command
        if 0 < len(levels) <= FEW_LEVELS:
            advice.append(
                f"The command {channel.name} takes only {len(levels)} levels ({channel.unit}). Gain, payload, dead "
                "zone and saturation then look alike. Record steps of many levels or a chirp."
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
        result.append(f"To distinguish {_listed(members)}: {_catalogue_advice(others or members)}")
    if len(compared) < 2:
        return result
    listed = list(doses.values())
    seconds = feasible_seconds(system, max(SECONDS, SHORTEST * windows.length))
    try:
        stage = make_stage(system, seconds, noise=windows.noise)
    except DesignError as error:
        text = f"No command sequence can be simulated to distinguish {_listed(compared)}: {error}."
        return [*result, f"{text} {_catalogue_advice(compared)}"]
    stage = replace(stage, start=replace(start, values={**reference.values, **QUIET}), window=windows.length)
    units = [dose.on(stage.start.values) for dose in listed]
    scans = scan(stage, listed, units, np.random.default_rng([seed, 23]), SEQUENCES_PER_FAMILY)
    share = np.max([s.separation.share for s in scans], axis=0)
    shown = np.concatenate([s.separation.seen for s in scans]).max(0)
    apart, twins = list(range(len(compared))), []
    for a, b in combinations(range(len(compared)), 2):
        clear = min(shown[a], shown[b]) > MIN_LIKELIHOOD_RATIO
        if share[a, b] < ALIKE and clear and a in apart and b in apart:
            twins += [n for n in (compared[a], compared[b]) if n not in twins]
            apart.remove(b)
    if twins:
        result.append(
            f"None of the tried command sequences distinguishes {_listed(twins)}. {_catalogue_advice(twins)}"
        )
    if len(apart) > 1:
        names = [compared[i] for i in apart]
        at_hand = LogAtHand(stage.start, replace(windows, state=reference.state), reference, {})
        now = at_hand.separation([listed[i] for i in apart])
        result.append(_sentence(system, stage, names, apart, scans, smallest_pair(now.ratio.sum(0)), logs))
    return result


def _doses(ranking: Ranking, start: Baseline, members: Sequence[str]) -> dict[str, Dose]:
    """Return the causes of a class at their fitted sizes.

    Causes without free parameters, what happens once, and causes that stay at their null value are left out: no command
    sequence can be simulated for them.
    """
    fits = {c.cause.name: c for c in ranking.candidates if c.fit is not ranking.reference}
    result = {}
    for name in members:
        if name in fits and fits[name].cause.free and not fits[name].cause.searched:
            values = {p: fits[name].fit.values[p] for p in fits[name].cause.free}
            if any(values[p] != start.values[p] for p in values):
                result[name] = Dose(fits[name].cause, values)
    return dict(list(result.items())[:MAX_COMPARED])


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
    command = ["deepkoco", "design-experiment", *naming(system), "--distinguish", *names]
    command += ["--recording", *logs] if logs else []
    text = f"To distinguish {_listed(names)}: "
    if best >= SETTLED:
        text += (
            f"record {seconds:.3g} s of {family.text}. The expected likelihood ratio is {best:.3g} (this log: "
            f"{now:.2g}; {SETTLED:.0f} is enough)."
        )
    else:
        needed = seconds * SETTLED / max(best, 1e-9)
        text += (
            f"the best tried sequence is {family.text}. Its expected likelihood ratio is {best:.2g} in "
            f"{seconds:.3g} s (this log: {now:.2g}; {SETTLED:.0f} is enough). It succeeds with a probability of "
            f"{100 * chance_of(best):.0f} %. "
        )
        text += f"About {needed:.2g} s would be needed. " if needed < 600.0 else "Longer logs hardly help. "
        text += _catalogue_advice(names)
    return f"{text} This command computes the best sequence: {shlex.join(command)}"


def naming(system: System) -> list[str]:
    """Return the arguments with which a command gets this system, as files are called from the current folder."""
    if isinstance(system, ExtendedSystem):
        return ["--model", str(system.source or "model.yaml")]
    # Of a robot that is not the package's, the command line takes the file and not the name.
    origin = origin_of(system)
    return ["--system", system.name if origin is None else stored_origin(origin, Path.cwd())]


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]


def _catalogue_advice(names: Sequence[str]) -> str:
    """Advice of the catalogue on how to distinguish these causes from similar ones."""
    kinds = [n.split("(")[0] for n in names]
    return " ".join(dict.fromkeys(CAUSES[k].advice for k in kinds if k in CAUSES))
