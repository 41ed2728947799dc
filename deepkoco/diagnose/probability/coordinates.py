"""Coordinates of the model: what every healthy unit has a little of, and what a cause changes.

A cause frees the coordinates of one of its starts. A start may only choose a shape (a number of detents per turn), at
which the sizes are slopes. Where it moves a size away from null, because no slope at null shows it (a dead zone), the
coordinate is the secant to that size, and it has one side.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.causes.parameter import widened
from deepkoco.diagnose.causes.tolerance import usual_sd
from deepkoco.diagnose.evidence.priors import declared
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.tangent import PARAMETER_STEP

WIDE = 0.5  # Cauchy scale of a change, in declared standard deviations of an effect
CHANGED = 0.2  # and of a parameter of the system, in standard deviations of its wide prior
TOLERANCE = 1e-3  # what any unit has of an effect, in Cauchy scales: 0.01 % of the load for dry friction
LOOSER = 50.0  # times that beside healthy logs, which tell how much this unit has
FREE_SHAPE = 10  # values of a shape that a log tells apart
SHAPES = (
    "frequency",
    "centre",
    "cycles",
    "pitch",
    "speed",
    "ratio",
    "distance",
    "relaxation",
    "start",
    "duration",
)  # useless while the size is null


@dataclass(frozen=True)
class Coordinate:
    """A change of one parameter.

    Attributes:
        parameter: Full name.
        dose: Finite change that its column is computed from, in the parameter's unit.
        wide: Cauchy scale of a change, in the parameter's unit.
        low: Smallest change.
        high: Largest change.
        place: Values of other parameters under which it acts.
        slope: Whether the dose is small enough to be a derivative.
    """

    parameter: str
    dose: float
    wide: float
    low: float
    high: float
    place: Mapping[str, float] = field(default_factory=dict)
    slope: bool = True

    @property
    def tolerated(self) -> bool:
        """Whether any unit has a little of it: a slope without a shape."""
        return self.slope and not self.shaped

    @property
    def shaped(self) -> bool:
        """Whether it acts at a chosen shape, place or time only."""
        return bool(self.place) or self.parameter in Push.NAMES


@dataclass(frozen=True)
class Item:
    """A cause from one start: the coordinates that it frees.

    Attributes:
        cause: The cause.
        columns: Numbers of its coordinates.
        start: Values that the start gives.
        choices: Number of shapes or places among which this one was chosen.
    """

    cause: Cause
    columns: tuple[int, ...]
    start: Mapping[str, float]
    choices: int


@dataclass(frozen=True)
class Catalogue:
    """All coordinates at one point, and the causes that free them.

    Attributes:
        base: Names of the system's own parameters that every fit frees.
        coordinates: Changes, those of the base parameters first, in their order.
        items: Causes from each of their starts.
    """

    base: tuple[str, ...]
    coordinates: tuple[Coordinate, ...]
    items: tuple[Item, ...]


def coordinates_of(
    problem: FitProblem,
    base: Sequence[str],
    values: Mapping[str, float],
    causes: Sequence[Cause],
    hints: Hints,
) -> Catalogue:
    """Return the coordinates of all causes that free parameters, around these values.

    Args:
        problem: Bounds and scales of all parameters.
        base: The system's own parameters.
        values: Values of all parameters at the point of linearisation.
        causes: The causes to try.
        hints: Data from which causes choose their starts.
    """
    known: dict[tuple, int] = {}
    coordinates: list[Coordinate] = []

    def number(coordinate: Coordinate) -> int:
        key = (
            coordinate.parameter,
            coordinate.slope or coordinate.dose,
            tuple(sorted(coordinate.place.items())),
        )
        if key not in known:
            known[key] = len(coordinates)
            coordinates.append(coordinate)
        return known[key]

    for name in base:
        parameter = widened(problem.system.parameter(name))
        number(_slope(problem, name, values, CHANGED * parameter.prior_sd, {}))
    items = []
    for cause in causes:
        if not cause.free or cause.scatter is not None or cause.traced:
            continue
        if is_changed(cause):
            if cause.free[0] in base:
                items.append(Item(cause, (base.index(cause.free[0]),), {}, 1))
            continue
        starts = cause.starts(hints.for_cause(cause))
        found: dict[tuple[int, ...], Mapping[str, float]] = {}
        for start in starts:
            columns = tuple(number(c) for c in _coordinates(problem, cause, start, values))
            if columns:
                found.setdefault(columns, start)
        choices = _places(hints) if cause.searched else max(cause.choices, _shapes(cause, found.values()))
        items += [Item(cause, columns, start, choices) for columns, start in found.items()]
    return Catalogue(tuple(base), tuple(coordinates), tuple(items))


def _shapes(cause: Cause, starts: Iterable[Mapping[str, float]]) -> int:
    """Number of shapes that the starts choose among; a free shape counts as `FREE_SHAPE` at least."""
    shapes = {tuple(sorted((n, v) for n, v in start.items() if is_shape(n))) for start in starts}
    return max(len(shapes), FREE_SHAPE if any(is_shape(n) for n in cause.free) else 1)


def _places(hints: Hints) -> int:
    """Number of places in time at which a push was searched for."""
    return max(sum(m.single.size for m in hints.missing), 1)


def _coordinates(
    problem: FitProblem, cause: Cause, start: Mapping[str, float], values: Mapping[str, float]
) -> list[Coordinate]:
    """Return the coordinates of one start."""
    shapes = {n: v for n, v in start.items() if is_shape(n)}
    moved = {n: v for n, v in start.items() if n not in shapes and v != values[n]}
    found = []
    for name in cause.free:
        if is_shape(name):
            continue
        (parameter,) = declared(problem, [name])
        wide = WIDE * parameter.prior_sd
        if name in moved:
            dose = moved[name] - values[name]
            # A rate that limits nothing has no scale of its own: the starts give it.
            wide = abs(dose) if abs(dose) > 10.0 * wide else wide
            side = (0.0, parameter.high - values[name]) if dose > 0.0 else (parameter.low - values[name], 0.0)
            found.append(Coordinate(name, dose, wide, *side, shapes, False))
        else:
            found.append(_slope(problem, name, values, wide, shapes))
    return found


def _slope(
    problem: FitProblem, name: str, values: Mapping[str, float], wide: float, place: Mapping[str, float]
) -> Coordinate:
    j = problem.names.index(name)
    low, high = problem.low[j] - values[name], problem.high[j] - values[name]
    step = PARAMETER_STEP * problem.scale[j]
    return Coordinate(name, -step if step > high else step, wide, float(low), float(high), place)


def is_shape(name: str) -> bool:
    """Return whether a parameter only says where or how a size acts (a frequency, a time): it has no null value."""
    return (name in Push.NAMES and name not in Push.SIZES) or name.rsplit(".", 1)[-1] in SHAPES


def tolerances(catalogue: Catalogue, loose: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns of which any unit has a little, besides its own parameters, and their standard deviations."""
    share = share_of_any(loose)
    own = len(catalogue.base)
    inside = [k for k, c in enumerate(catalogue.coordinates) if k >= own and c.tolerated]
    return np.array(inside, dtype=int), np.array([share * catalogue.coordinates[k].wide for k in inside])


def share_of_any(loose: bool) -> float:
    """Return what any unit has of an effect, in Cauchy scales; a unit of which only a model file is known has more."""
    return TOLERANCE * (LOOSER if loose else 1.0)


def spreads(problem: FitProblem, catalogue: Catalogue, inside: np.ndarray) -> np.ndarray:
    """Return the usual standard deviations from log to log of base parameters and tolerated changes.

    They are 2 % of a parameter and 10 % of a friction. A parameter that is 0 has a tenth of its declared standard
    deviation, and a tolerated change the tolerance of a unit without healthy logs.
    """
    own = [usual_sd(problem.system.parameter(name)) for name in catalogue.base]
    return np.array([*own, *(TOLERANCE * catalogue.coordinates[k].wide for k in inside)])
