"""Scale gauges: parameters that can be multiplied together without any change of the measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from deepkoco.fit.fit_types import Fit
from deepkoco.systems import Parameter

CANCELS = 1e-6  # information along a gauge, as a share of what its members have one by one
SMALL = 0.02  # exponent below which a parameter does not belong to a gauge

# Unit -> how a parameter of this unit is measured by itself; the easiest first.
MEASURED = {
    "kg": "weigh it",
    "m": "measure it with a ruler",
    "ohm": "measure it with an ohmmeter",
    "N m/A": "hold the shaft with a lever on a scale at a known current",
    "N m/V": "hold the shaft with a lever on a scale at a known voltage",
    "N m": "hold the joint with a lever on a scale",
    "N m/rad": "push the joint with a known force and read its angle",
    "kg m2": "take it from a drawing, or let the part swing as a pendulum",
}


@dataclass(frozen=True)
class Gauge:
    """Parameters of which the data give only ratios.

    Attributes:
        fixed: The one whose value must come from elsewhere: of those that may be chosen, the most reliable one.
        exponents: Parameter -> exponent e: if ``fixed`` is c times as large, this one is c^e times as large (to first
            order) and the measurements stay the same. ``fixed`` itself has 1.
        measure: The member whose measurement settles it most easily.
        how: How it is measured.
    """

    fixed: str
    exponents: dict[str, float]
    measure: str
    how: str

    @property
    def text(self) -> str:
        """One or two sentences for a reader."""
        others = {n: e for n, e in self.exponents.items() if n != self.fixed}
        if all(abs(2.0 * e - round(2.0 * e)) <= 2.0 * SMALL for e in others.values()):
            powers = {n: round(2.0 * e) / 2.0 for n, e in others.items()}
            scaled = [f"{n} c{'' if e == 1.0 else f'^{e:g}'} times" for n, e in powers.items()]
            change = f"with {self.fixed} c times, {_listed(scaled)} as large, nothing measured changes"
        else:
            change = "other values of all of them together give the same measurements"
        return (
            f"The data give only ratios of {_listed([self.fixed, *others])}: {change}. "
            f"One measurement settles it: {self.measure}; {self.how}."
        )

    def to_json(self) -> dict[str, object]:
        """Return the gauge as plain values."""
        return {
            "fixed": self.fixed,
            "exponents": self.exponents,
            "measure": self.measure,
            "how": self.how,
            "text": self.text,
        }


def text_of_gauges(gauges: Sequence[Gauge]) -> tuple[str, ...]:
    """Advice about scale gauges: what to measure, and what is taken as given until then; empty without any."""
    if not gauges:
        return ()
    if len(gauges) == 1:
        return (
            f"{gauges[0].text} Until then, {gauges[0].fixed} keeps its value as given; the intervals count how well "
            "that is known.",
        )
    members = list(dict.fromkeys(n for g in gauges for n in g.exponents))
    ways: dict[str, list[str]] = {}
    for gauge in gauges:
        ways.setdefault(gauge.how, []).append(gauge.measure)
    each = {way if len(names) == 1 else way.replace(" it", " each", 1): names for way, names in ways.items()}
    how = "; ".join(f"{_listed(names)} ({way})" for way, names in each.items())
    fixed = _listed([g.fixed for g in gauges])
    return (
        f"The data give only ratios of {_listed(members)}. {len(gauges)} measurements settle them: {how}. "
        f"Until then, {fixed} keep their values as given; the intervals count how well these are known.",
    )


def scale_gauges(fit: Fit, declared: Sequence[Parameter]) -> tuple[Gauge, ...]:
    r"""Find the scale gauges of a fit.

    With the information I of the data and the values p, G = diag(p) I diag(p) is the information in log p. Scaled to a
    unit diagonal it has an eigenvalue 0 for every way in which changes of several parameters cancel. A single parameter
    about which the data say little is none. Each gauge gets the most reliable parameter (smallest relative prior) of
    those that are independent.

    Args:
        fit: The fit, with the information of its data alone.
        declared: Declarations of its free parameters; those at 0 or below have no scale and are left out.
    """
    known = {p.name: p for p in declared}
    names = [n for n in fit.free if n in known and fit.values[n] > 0.0]
    index = [fit.free.index(n) for n in names]
    value = np.array([fit.values[n] for n in names])
    information = fit.information[np.ix_(index, index)] * np.outer(value, value)
    size = np.diag(information).copy()
    seen = np.isfinite(size) & (size > 0.0)
    names = [n for n, yes in zip(names, seen, strict=True) if yes]
    if len(names) < 2:
        return ()
    root = np.sqrt(size[seen])
    weight, ways = np.linalg.eigh(information[np.ix_(seen, seen)] / np.outer(root, root))
    null = ways[:, weight < CANCELS] / root[:, None]
    if null.shape[1] == 0:
        return ()
    null = _separated(null)
    # The change of a parameter that the data determine by itself is rounding.
    null[np.abs(null) < 1e-4] = 0.0
    fixed = _reliable(null, np.array([known[n].prior_sd / fit.values[n] for n in names]))
    if len(fixed) < null.shape[1]:
        return ()
    ways = null @ np.linalg.inv(null[fixed])
    measured = _measured(ways, [known[n] for n in names])
    result = []
    for k, i in enumerate(fixed):
        exponents = {n: float(e) for n, e in zip(names, ways[:, k], strict=True) if abs(e) > SMALL}
        if len(exponents) > 1:
            easiest = known[names[measured[k]]]
            how = MEASURED.get(easiest.unit, "measure it by itself")
            result.append(Gauge(names[i], exponents, easiest.name, how))
    return tuple(result)


def _separated(null: np.ndarray) -> np.ndarray:
    """Return another basis (n, K) of the same ways, each with a largest change of 1 that no other way has.

    A parameter that the data hardly show can dominate every way, and what else these contain would seem to be rounding.
    """
    ways, pivots = null.copy(), []
    for k in range(ways.shape[1]):
        ways[:, k:] /= np.maximum(np.abs(ways[:, k:]).max(0), np.finfo(float).tiny)
        left = np.abs(ways[:, k:])
        left[pivots] = 0.0
        i, j = np.unravel_index(left.argmax(), left.shape)
        ways[:, [k, k + j]] = ways[:, [k + j, k]]
        ways[:, k] /= ways[i, k]
        others = [c for c in range(ways.shape[1]) if c != k]
        ways[:, others] -= np.outer(ways[:, k], ways[i, others])
        pivots.append(int(i))
    return ways / np.abs(ways).max(0)


def _reliable(null: np.ndarray, sd: np.ndarray) -> list[int]:
    """Index of the parameter to keep for each gauge: the one whose prior says most about the way along the gauges.

    That is not the one with the smallest prior. Where only the sum of a servo's rate gain and of a small damping shows,
    the damping would need fifteen times its value for what is a change of the gain by its standard deviation.

    Args:
        null: (n, K) relative changes that cancel.
        sd: (n,) relative standard deviations.
    """
    rows = np.linalg.qr(null / sd[:, None])[0]
    chosen: list[int] = []
    for _ in range(null.shape[1]):
        # Rounded: parameters that say equally much are taken in their order.
        says = np.round((rows**2).sum(1), 6)
        best = int(says.argmax())
        if not says[best] > 0.0:
            break
        chosen.append(best)
        way = rows[best] / np.linalg.norm(rows[best])
        rows = rows - np.outer(rows @ way, way)
    return chosen


def _measured(ways: np.ndarray, parameters: Sequence[Parameter]) -> list[int]:
    """Index of a parameter to measure for each gauge: those that are measured most easily and together settle all.

    Args:
        ways: (n, K) exponents.
        parameters: The n parameters.
    """
    units = list(MEASURED)
    ease = [units.index(p.unit) if p.unit in MEASURED else len(units) for p in parameters]
    chosen: list[int] = []
    # What a row adds to those before it; the rows of the parameters that are kept are unit vectors, so K are found.
    rest = ways.copy()
    for i in sorted(range(len(parameters)), key=ease.__getitem__):
        length = float(np.linalg.norm(rest[i]))
        if length > SMALL and len(chosen) < ways.shape[1]:
            chosen.append(i)
            rest = rest - np.outer(rest @ rest[i], rest[i]) / length**2
    _, order = linear_sum_assignment((np.abs(ways[chosen]) <= SMALL).T)
    return [chosen[i] for i in order]


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else words[0]
