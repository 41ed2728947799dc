"""Doses: sizes of the causes for which an experiment is designed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from deepkoco.diagnose.causes import Cause
from deepkoco.fit.tangent import PARAMETER_STEP
from deepkoco.systems import ExtendedSystem

# Parameters that only choose a shape, and parameters that a similar cause of the family also has.
SHAPES = {
    "stribeck": ("coulomb", "speed"),
    "cogging": ("cycles", "pitch", "cosine"),
    "periodic": ("frequency", "cosine"),
    "spring": ("centre",),
    "sensor_ripple": ("cycles", "cosine"),
    "sensor_shift": ("start", "duration"),
    "bristle": ("distance",),
    "lugre": ("distance", "ratio", "speed"),
}


@dataclass(frozen=True)
class Dose:
    """One cause at one size.

    Attributes:
        cause: The cause, at its site.
        values: Its parameters, by their full names.
    """

    cause: Cause
    values: Mapping[str, float]

    def on(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters of a baseline with this cause."""
        return {**values, **self.values}

    def scaled(self, factor: float, system: ExtendedSystem) -> Dose:
        """Return a dose with the distance from null multiplied by ``factor``, inside the bounds."""
        result = {}
        for name, value in self.values.items():
            p, null = system.parameter(name), null_value(system, name)
            far = value if is_shape(self.cause, name) else null + factor * (value - null)
            result[name] = min(max(far, p.low), p.high)
        return Dose(self.cause, result)

    def directions(self, values: Mapping[str, float], system: ExtendedSystem) -> list[dict[str, float]]:
        """Return parameter sets whose simulations span the effect of the cause: the dose, then each parameter moved."""
        at = self.on(values)
        result = [at]
        for name in self.cause.free:
            p = system.parameter(name)
            step = PARAMETER_STEP * p.prior_sd
            result.append({**at, name: at[name] + (step if at[name] + step <= p.high else -step)})
        return result


def unit_dose(cause: Cause, system: ExtendedSystem) -> Dose:
    """Return a dose of a tenth of each parameter's prior standard deviation, away from its bound."""
    values = {}
    for name in cause.free:
        p, null = system.parameter(name), null_value(system, name)
        step = 0.0 if is_shape(cause, name) else 0.1 * p.prior_sd
        values[name] = null + step if null + step <= p.high else null - step
    # A weak actuator is more likely than a strong one, and commands at their limit show both equally well.
    if cause.kind == "gain":
        values = {n: 2.0 * null_value(system, n) - v for n, v in values.items()}
    return Dose(cause, values)


def is_shape(cause: Cause, name: str) -> bool:
    """Return whether a parameter only chooses a shape."""
    return name.rsplit(".", 1)[-1] in SHAPES.get(cause.kind, ())


def null_value(system: ExtendedSystem, name: str) -> float:
    """Return the value at which an effect's parameter changes nothing."""
    if "." not in name:
        return system.base.parameter(name).value
    bare = ExtendedSystem(system.base, (name.rsplit(".", 1)[0],))
    return bare.parameter(name).value
