"""Design of an experiment: commands that distinguish the given causes, or an error if no command can."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from scipy.stats import norm

from deepkoco.diagnose.causes import CAUSES, Cause, UnknownCauseError, catalogue, causes_named
from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.experiment_design.choose import choose
from deepkoco.diagnose.experiment_design.doses import Dose, unit_dose
from deepkoco.diagnose.experiment_design.experiment_setup import (
    COMMAND_RATE,
    SENSOR_RATE,
    DesignError,
    Stage,
    make_stage,
)
from deepkoco.diagnose.experiment_design.families import FAMILIES
from deepkoco.diagnose.experiment_design.log_at_hand import LogAtHand, fit_log
from deepkoco.diagnose.experiment_design.rehearsal import Rehearsal
from deepkoco.diagnose.experiment_design.search import (
    GENERATIONS,
    SCANNED,
    Scan,
    costs,
    draw_unit,
    evolve,
    judge,
    scan,
    sequences,
)
from deepkoco.diagnose.experiment_design.separation import smallest_pair
from deepkoco.fit.threads import one_thread
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, System, any_system

STRENGTH = 0.5  # ES of each cause in a usual log
TRAINED = 0.75  # share of the windows that a diagnosis fits; the others are held out
SETTLED = 24.0  # likelihood ratio from which two causes are distinguished in 95 % of the logs
ALIKE = 1e-5  # share of a cause's effect that a rival cannot imitate, below which the two count as equal
CONFIRMED = 2  # number of final candidates that are refitted; more if these break a limit
DRAWS = 4  # units on which the final candidates are compared
FINAL_CANDIDATES = 4


class InseparableError(DesignError):
    """No command distinguishes two causes.

    Attributes:
        pair: Their names.
        advice: Other experiments that distinguish them.
    """

    def __init__(self, pair: tuple[str, str], advice: Sequence[str]) -> None:
        self.pair, self.advice = pair, tuple(advice)
        super().__init__(
            f"{pair[0]} and {pair[1]} cannot be distinguished by any command: both give the same measurements under "
            f"all tried commands. Use another experiment. {' '.join(advice)}"
        )


@dataclass(frozen=True)
class Design:
    """A designed experiment and its expected likelihood ratios.

    Attributes:
        causes: Names of the causes to distinguish.
        doses: Their sizes.
        stage: Setup of the experiment.
        family: Family of the sequence.
        point: Its parameters in the unit cube.
        sequence: (n, M) commands, before any feedback.
        linear: (C, C) expected likelihood ratio of a log of the first cause against the second, to first order.
        ratio: (C, C) the same by refits, which is more accurate.
        strength: (C,) ES of each cause in this experiment.
        worst: Smallest ratio, to first order, over units drawn from the prior.
        typical: Family -> smallest ratio of a usual sequence of that family, to first order.
        at_hand: Smallest ratio in the log at hand, scaled to the length of this experiment; None without a log.
        rehearsals: Simulation of the sequence with each cause.
        seed: Seed of the search.
    """

    causes: tuple[str, ...]
    doses: tuple[Dose, ...]
    stage: Stage
    family: str
    point: np.ndarray
    sequence: np.ndarray
    linear: np.ndarray
    ratio: np.ndarray
    strength: np.ndarray
    worst: float
    typical: Mapping[str, float]
    at_hand: float | None
    rehearsals: list[Rehearsal] = field(repr=False)
    seed: int

    @property
    def smallest(self) -> float:
        """Expected likelihood ratio of the pair that is hardest to distinguish."""
        return smallest_pair(self.ratio)

    @property
    def chance(self) -> float:
        """Probability that a diagnosis of the recorded log distinguishes that pair."""
        return chance_of(self.smallest)

    @property
    def settles(self) -> bool:
        """Whether this probability is at least about 95 %."""
        return self.smallest >= SETTLED

    @property
    def seconds_needed(self) -> float:
        """Length [s] from which the repeated experiment would distinguish that pair."""
        return self.stage.frame.seconds * max(1.0, SETTLED / max(self.smallest, 1e-12))


def chance_of(ratio: float) -> float:
    """Return the probability that the observed likelihood ratio exceeds ``APART``; its sd is 2 sqrt(ratio)."""
    return float(norm.cdf((ratio - APART) / (2.0 * math.sqrt(max(ratio, 1.0)))))


def design_experiment(
    system: str | System,
    distinguish: Sequence[str],
    recordings: Sequence[Recording] = (),
    *,
    seconds: float = 10.0,
    limits: Mapping[str, tuple[float, float]] | None = None,
    strength: float | None = None,
    command_rate: float = COMMAND_RATE,
    sensor_rate: float = SENSOR_RATE,
    seed: int = 0,
    scanned: int = SCANNED,
    generations: int = GENERATIONS,
    progress: Callable[[str, int, float], None] | None = None,
) -> Design:
    """Find the command sequence that best distinguishes causes.

    The search covers several families of sequences. It maximises the smallest expected likelihood ratio over all
    ordered pairs of causes, with the parameters of the baseline and of the rival refitted. Sequences are compared to
    first order on units drawn from the prior; the final candidates are compared by refits.

    Args:
        system: Name, or a system (plain, or loaded from model.yaml).
        distinguish: Two or more causes, by their names at this system.
        recordings: Log at hand, for the sizes of the causes, the noise and the parameters of the unit.
        seconds: Length of the experiment [s].
        limits: (low, high) by the name of a command, coordinate or speed.
        strength: ES of each cause in a usual sequence of steps (or in the log). None takes the sizes fitted to the
            log; causes that no log shows get 0.5.
        command_rate: Commands per second [Hz].
        sensor_rate: Samples per second [Hz].
        seed: Seed of the search.
        scanned: Sequences of each family that are tried first.
        generations: Generations of the evolution of the best two families.
        progress: Called with family, generation and best ratio so far.

    Raises:
        DesignError: A name is unknown, no command shows a cause, or no sequence keeps the limits.
        InseparableError: No command distinguishes two of the causes.
    """
    base = any_system(system)
    causes = known_causes(base, distinguish)
    with one_thread():
        log = fit_log(recordings, base, causes) if recordings else None
        generator = np.random.default_rng([seed, 17])
        noise, values = (log.windows.noise, log.refit.values) if log else (None, None)
        stage = make_stage(base, seconds, limits, command_rate, sensor_rate, noise, values)
        doses = sized(stage, causes, log, strength, generator)
        # A sequence that needs the exact nominal parameters (such as balancing upright) fails on the unit, so
        # sequences are also compared on drawn units.
        units = [draw_unit(stage, dose, generator) for dose in doses]
        scans = scan(stage, doses, units, generator, scanned)
        check_separable(stage, doses, scans)
        candidates = evolve(stage, doses, units, scans, generator, generations, progress)
        return _decide(stage, doses, log, scans, candidates[:FINAL_CANDIDATES], generator, seed)


def known_causes(system: System, names: Sequence[str]) -> list[Cause]:
    """Return the causes with the given names at a system.

    Raises:
        DesignError: A name is unknown, fewer than two causes are given, or no command sequence can show a cause.
    """
    base = system.base if isinstance(system, ExtendedSystem) else system
    try:
        causes = causes_named(catalogue(base), names, base.name)
    except UnknownCauseError as error:
        raise DesignError(str(error)) from error
    if len(causes) < 2:
        raise DesignError("give two or more different causes to distinguish")
    for cause in causes:
        if cause.scatter is not None:
            raise DesignError(
                f"{cause.name} changes the scatter of the measurements under every command, so no sequence shows it "
                f"better than another. {cause.advice}"
            )
        if cause.traced:
            raise DesignError(
                f"{cause.name} shows equally in every sequence with fast and large changes of the command, so there is "
                f"nothing to design. {cause.advice}"
            )
        if not cause.free or cause.searched:
            raise DesignError(f"no command sequence can test {cause.name}. {cause.advice}")
    return causes


def sized(
    stage: Stage,
    causes: Sequence[Cause],
    log: LogAtHand | None,
    strength: float | None,
    generator: np.random.Generator,
) -> list[Dose]:
    """Return the dose of each cause: as fitted to the log, or such that a usual sequence shows it with strength ES."""
    fitted = {} if log is None or strength is not None else log.doses
    wanted = STRENGTH if strength is None else strength
    missing = [c for c in causes if c.name not in fitted]
    found = dict(fitted)
    if missing:
        doses = [unit_dose(c, stage.system) for c in missing]
        usual = _usual(stage, generator)
        for _ in range(6):
            shown = (
                log.separation(doses).strength[0]
                if log is not None
                else np.median(judge(stage, usual, doses, [stage.start.values])[0].strength, axis=0)
            )
            if bool((np.abs(shown / wanted - 1.0) < 0.1).all()):
                break
            doses = [
                d.scaled(float(np.clip(wanted / max(s, 1e-9), 0.05, 20.0)), stage.system)
                for d, s in zip(doses, shown, strict=True)
            ]
        found |= {c.name: d for c, d in zip(missing, doses, strict=True)}
    return [found[c.name] for c in causes]


def _usual(stage: Stage, generator: np.random.Generator) -> np.ndarray:
    """Return steps of full size (K, n, M)."""
    family = FAMILIES["steps"]
    points = generator.random((8, family.dimension(stage.frame)))
    points[:, -1] = 0.0
    return sequences(stage, family, points)


def check_separable(stage: Stage, doses: Sequence[Dose], scans: Sequence[Scan]) -> None:
    """Check that the scanned commands show every cause and distinguish every pair.

    Raises:
        DesignError: A cause does not change any measurement.
        InseparableError: Two causes give the same measurements under all scanned commands.
    """
    shown = np.concatenate([s.separation.strength for s in scans]).max(0)
    for dose, s in zip(doses, shown, strict=True):
        if s < 1e-6:
            raise DesignError(
                f"{dose.cause.name} changes no measurement of {stage.system.name}. {dose.cause.advice}"
            )
    pairs = alike_pairs(doses, scans)
    if pairs:
        a, b = pairs[0]
        advice = dict.fromkeys(CAUSES[doses[i].cause.kind].advice for i in (a, b))
        raise InseparableError((doses[a].cause.name, doses[b].cause.name), tuple(advice))


def alike_pairs(doses: Sequence[Dose], scans: Sequence[Scan]) -> list[tuple[int, int]]:
    """Return the pairs of causes that give the same measurements under every scanned sequence."""
    share = np.max([s.separation.share for s in scans], axis=0)
    return [p for p in combinations(range(len(doses)), 2) if share[p] < ALIKE]


def _decide(
    stage: Stage,
    doses: list[Dose],
    log: LogAtHand | None,
    scans: Sequence[Scan],
    candidates: Sequence,
    generator: np.random.Generator,
    seed: int,
) -> Design:
    tried = np.concatenate([sequences(stage, family, point[None]) for family, point in candidates])
    units = [draw_unit(stage, doses[k % len(doses)], generator) for k in range(DRAWS)]
    found, excess = judge(stage, tried, doses, units)
    order = np.argsort(costs(found.smallest, excess), kind="stable")
    choice = choose(stage, tried, order.tolist(), doses, CONFIRMED)
    best = choice.index
    family, point = candidates[best]
    nominal = judge(stage, tried[best : best + 1], doses, [stage.start.values])[0]
    at_hand = None
    if log is not None:
        per_second = smallest_pair(log.separation(doses).ratio.sum(0)) / log.seconds
        at_hand = TRAINED * per_second * stage.frame.seconds
    return Design(
        tuple(d.cause.name for d in doses),
        tuple(doses),
        stage,
        family.name,
        point,
        tried[best],
        TRAINED * nominal.ratio[0],
        TRAINED * choice.ratio,
        nominal.strength[0],
        TRAINED * float(found.smallest[best]),
        {s.family.name: TRAINED * s.typical for s in scans},
        at_hand,
        choice.rehearsals,
        seed,
    )
