"""Search for the command sequence that best distinguishes causes: a scan of every family, then evolution."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from deepkoco.diagnose.experiment_design.doses import Dose
from deepkoco.diagnose.experiment_design.experiment_setup import DesignError, Stage
from deepkoco.diagnose.experiment_design.families import FAMILIES, Family
from deepkoco.diagnose.experiment_design.rehearsal import rehearse
from deepkoco.diagnose.experiment_design.separation import Separation, separate

SCANNED = 12  # scanned sequences of each family
EVOLVED = 2  # families whose best sequences are evolved
GENERATIONS = 8
BAD = 1e3  # cost of a sequence that breaks its limits


@dataclass(frozen=True)
class Scan:
    """Sequences of one family.

    Attributes:
        family: The family.
        points: (K, d) in the unit cube.
        separation: Expected likelihood ratios between the causes.
        excess: (K,) excess over the limits, as a share of them.
    """

    family: Family
    points: np.ndarray
    separation: Separation
    excess: np.ndarray

    @property
    def allowed(self) -> np.ndarray:
        """(K,) whether a sequence keeps the limits."""
        return self.excess <= 0.0

    @property
    def cost(self) -> np.ndarray:
        """(K,) cost to be minimised."""
        return costs(self.separation.smallest, self.excess)

    @property
    def best(self) -> np.ndarray:
        """(d,) best point."""
        return self.points[int(np.argmin(self.cost))]

    @property
    def typical(self) -> float:
        """Median of the smallest ratio over the sequences that keep the limits; NaN if none does."""
        kept = self.separation.smallest[self.allowed]
        return float(np.median(kept)) if len(kept) else float("nan")


def costs(smallest: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Return minus the logarithm of the ratio (K,); a sequence that breaks its limits costs more than any other."""
    broken = BAD * (1.0 + np.minimum(excess, 1e6))
    return np.where(excess > 0.0, broken, -np.log(np.maximum(smallest, 1e-12)))


def judge(
    stage: Stage, feedforward: np.ndarray, doses: Sequence[Dose], units: Sequence[Mapping[str, float]]
) -> tuple[Separation, np.ndarray]:
    """Return the separation of causes in sequences (K, n, M), and the excess over the limits; worst over units."""
    played = rehearse(stage, feedforward, units)
    values = stage.start.values
    found = separate(stage.system, played.windows, values, stage.start.prior, doses)
    return found.worst(len(units)), played.excess.reshape(len(units), -1).max(0)


def scan(
    stage: Stage,
    doses: Sequence[Dose],
    units: Sequence[Mapping[str, float]],
    generator: Generator,
    count: int = SCANNED,
) -> tuple[Scan, ...]:
    """Scan sequences of every family, spread over its parameters."""
    result = []
    for family in FAMILIES.values():
        size = family.dimension(stage.frame)
        points = qmc.LatinHypercube(size, rng=generator).random(count)
        found, excess = judge(stage, sequences(stage, family, points), doses, units)
        if not bool((excess <= 0.0).any()):
            # The limits are tight, so only small sequences can keep them.
            points[:, -1] = 0.85 + 0.15 * points[:, -1]
            found, excess = judge(stage, sequences(stage, family, points), doses, units)
        result.append(Scan(family, points, found, excess))
    return tuple(result)


def sequences(stage: Stage, family: Family, points: np.ndarray) -> np.ndarray:
    """Return the commands (K, n, M) of points (K, d)."""
    return stage.commands(family.signals(points, stage.frame))


def evolve(
    stage: Stage,
    doses: Sequence[Dose],
    units: Sequence[Mapping[str, float]],
    scans: Sequence[Scan],
    generator: Generator,
    generations: int = GENERATIONS,
    progress: Callable[[str, int, float], None] | None = None,
) -> list[tuple[Family, np.ndarray]]:
    """Return candidates from best to worst: the best point of each family; those of the best families are evolved.

    Raises:
        DesignError: No sequence keeps the limits.
    """
    allowed = [s for s in scans if s.allowed.any()]
    if not allowed:
        least = min(float(s.excess.min()) for s in scans)
        raise DesignError(
            f"no sequence keeps the limits: the gentlest exceeds them by {100 * least:.0f} %; widen the limits of "
            "position and speed, or narrow those of the commands"
        )
    order = sorted(allowed, key=lambda s: float(s.cost.min()))
    found = [(s.family, s.best) for s in order]
    for rank, chosen in enumerate(order[:EVOLVED]):
        family, done = chosen.family, [0]

        def cost(x: np.ndarray, family: Family = family, done: list[int] = done) -> np.ndarray:
            points = np.atleast_2d(x.T)
            found, excess = judge(stage, sequences(stage, family, points), doses, units)
            result = costs(found.smallest, excess)
            done[0] += 1
            if progress is not None:
                progress(family.name, done[0], float(np.exp(-result.min())) if result.min() < BAD else 0.0)
            return result

        evolved = differential_evolution(
            cost,
            [(0.0, 1.0)] * chosen.points.shape[1],
            init=chosen.points,  # pyright: ignore[reportArgumentType]
            maxiter=generations,
            vectorized=True,
            updating="deferred",
            polish=False,
            tol=0.0,
            rng=generator,
        )
        found[rank] = (family, np.asarray(evolved.x))
    return found


def draw_unit(stage: Stage, dose: Dose, generator: Generator) -> dict[str, float]:
    """Draw a unit with a cause; its other parameters lie within two standard deviations of the prior."""
    prior = stage.start.prior
    spread = np.sqrt(np.diag(prior.covariance))
    shift = np.clip(generator.standard_normal(len(spread)), -2.0, 2.0) * spread
    values = dict(stage.start.values)
    for name, move in zip(prior.names, shift, strict=True):
        p = stage.system.parameter(name)
        values[name] = float(np.clip(values[name] + move, p.low, p.high))
    return dose.on(values)
