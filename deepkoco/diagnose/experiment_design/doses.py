"""How much of each cause an experiment is designed for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from deepkoco.diagnose.causes import Cause
from deepkoco.fit.solve.levenberg_marquardt import PARAMETER_STEP
from deepkoco.systems import ExtendedSystem

# Parameters that only choose a shape, and those of a dose that a neighbour of the family has too.
SHAPES = {
    "stribeck": ("coulomb", "speed"),
    "cogging": ("cycles", "cosine"),
    "periodic": ("frequency", "cosine"),
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
        """Parameters of a baseline with this cause."""
        return {**values, **self.values}

    def scaled(self, factor: float, system: ExtendedSystem) -> Dose:
        """A dose that many times as far from null, inside the bounds."""
        result = {}
        for name, value in self.values.items():
            p, null = system.parameter(name), null_value(system, name)
            far = value if is_shape(self.cause, name) else null + factor * (value - null)
            result[name] = min(max(far, p.low), p.high)
        return Dose(self.cause, result)

    def directions(self, values: Mapping[str, float], system: ExtendedSystem) -> list[dict[str, float]]:
        """Parameter sets that show how the cause moves the measurements: the dose, then each parameter nudged."""
        at = self.on(values)
        result = [at]
        for name in self.cause.free:
            p = system.parameter(name)
            step = PARAMETER_STEP * p.prior_sd
            result.append({**at, name: at[name] + (step if at[name] + step <= p.high else -step)})
        return result


def unit_dose(cause: Cause, system: ExtendedSystem) -> Dose:
    """A dose of a tenth of each parameter's prior spread, away from its bound."""
    values = {}
    for name in cause.free:
        p, null = system.parameter(name), null_value(system, name)
        step = 0.0 if is_shape(cause, name) else 0.1 * p.prior_sd
        values[name] = null + step if null + step <= p.high else null - step
    # A weak actuator is likelier than a strong one, and a command that is at its limit shows it alike.
    if cause.kind == "gain":
        values = {n: 2.0 * null_value(system, n) - v for n, v in values.items()}
    return Dose(cause, values)


def is_shape(cause: Cause, name: str) -> bool:
    """Whether a parameter chooses a shape only."""
    return name.rsplit(".", 1)[-1] in SHAPES.get(cause.kind, ())


def null_value(system: ExtendedSystem, name: str) -> float:
    """Value of an effect's parameter that changes nothing."""
    bare = ExtendedSystem(system.base, (name.rsplit(".", 1)[0],))
    return bare.parameter(name).value
