"""Final choice among candidate sequences: by refits, and by the limits on a unit with each cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepkoco.diagnose.experiment_design.confirm import confirm
from deepkoco.diagnose.experiment_design.doses import Dose
from deepkoco.diagnose.experiment_design.experiment_setup import DesignError, Stage
from deepkoco.diagnose.experiment_design.rehearsal import Rehearsal
from deepkoco.diagnose.experiment_design.separation import smallest_pair


@dataclass(frozen=True)
class Choice:
    """A candidate that was refitted.

    Attributes:
        index: Its index among the candidates.
        ratio: (C, C) expected likelihood ratio by refits.
        rehearsals: Simulation of the sequence with each cause.
    """

    index: int
    ratio: np.ndarray
    rehearsals: list[Rehearsal]

    @property
    def excess(self) -> float:
        """Largest excess over a limit with any of the causes in the unit, as a share of the limit."""
        return max(float(p.excess.max()) for p in self.rehearsals)


def choose(
    stage: Stage, tried: np.ndarray, order: Sequence[int], doses: Sequence[Dose], count: int
) -> Choice:
    """Refit candidates until enough are refitted and one of them keeps the limits; return the best one that does.

    Args:
        stage: The experiment.
        tried: (K, n, M) sequences.
        order: Order of the refits, the most promising candidate first.
        doses: C causes.
        count: Least number of refitted candidates.

    Raises:
        DesignError: With a cause in the unit, every candidate breaks a limit.
    """
    refitted: list[Choice] = []
    for k in order:
        if len(refitted) >= count and any(c.excess <= 0.0 for c in refitted):
            break
        refitted.append(Choice(int(k), *confirm(stage, tried[k], doses)))
    # A safety limit also holds for the unit with the cause, and no likelihood ratio compensates for breaking it.
    kept = [c for c in refitted if c.excess <= 0.0]
    if kept:
        return max(kept, key=lambda c: smallest_pair(c.ratio))
    gentlest = min(refitted, key=lambda c: c.excess)
    worst = int(np.argmax([p.excess.max() for p in gentlest.rehearsals]))
    name, reached, limit = broken_limit(stage, gentlest.rehearsals[worst].path)
    raise DesignError(
        f"no sequence keeps the limits on a unit with {doses[worst].cause.name}: the gentlest of {len(refitted)} "
        f"brings {name} to {reached:.4g} where {limit:.4g} is allowed, {100.0 * gentlest.excess:.2g} % too far; "
        f"widen the limit of {name}, or narrow those of the commands"
    )


def broken_limit(stage: Stage, path: np.ndarray) -> tuple[str, float, float]:
    """Return the limit that paths (K, T, S) exceed most, relative to its size: state name, value reached, limit.

    Values of a speed are magnitudes. A path that is not finite has reached infinity.
    """
    joints, limits, names = stage.system.joints, stage.limits, stage.system.state_names
    found: list[tuple[float, str, float, float]] = []
    for j in range(joints):
        speed = float(np.abs(path[..., joints + j]).max())
        found.append(
            (_share(speed - limits.speed[j], limits.speed[j]), names[joints + j], speed, limits.speed[j])
        )
        low, high = limits.position[j]
        reach = high - low if np.isfinite(high - low) else 1.0
        top, bottom = float(path[..., j].max()), float(path[..., j].min())
        found.append((_share(top - high, reach), names[j], top, high))
        found.append((_share(low - bottom, reach), names[j], bottom, low))
    _, name, reached, limit = max(found)
    return name, reached if np.isfinite(reached) else np.inf, float(limit)


def _share(over: float, size: float) -> float:
    if not np.isfinite(size):
        return -np.inf
    return float(over / size) if np.isfinite(over) or over < 0.0 else np.inf
