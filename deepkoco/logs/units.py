"""Units of logs and their conversion to SI."""

import math
from dataclasses import dataclass


class UnitError(ValueError):
    """A unit is unknown, or measures another quantity than expected."""


@dataclass(frozen=True)
class Unit:
    """One unit: its quantity, its value in SI units (factor), and the SI unit of the quantity."""

    quantity: str
    factor: float
    si: str


_TURN = 2.0 * math.pi
_DEGREE = math.pi / 180.0

# quantity: (SI unit, {spelling: value in SI units})
_TABLE: dict[str, tuple[str, dict[str, float]]] = {
    "time": ("s", {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}),
    "angle": ("rad", {"rad": 1.0, "mrad": 1e-3, "deg": _DEGREE, "rev": _TURN}),
    "angular velocity": (
        "rad/s",
        {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE, "rev/s": _TURN, "rpm": _TURN / 60.0},
    ),
    "angular acceleration": ("rad/s^2", {"rad/s^2": 1.0, "deg/s^2": _DEGREE}),
    "torque": ("N m", {"N m": 1.0, "mN m": 1e-3, "uN m": 1e-6, "kN m": 1e3, "N cm": 1e-2}),
    "voltage": ("V", {"V": 1.0, "mV": 1e-3, "kV": 1e3}),
    "current": ("A", {"A": 1.0, "mA": 1e-3}),
    "force": ("N", {"N": 1.0, "mN": 1e-3, "kN": 1e3}),
    "mass": ("kg", {"kg": 1.0, "g": 1e-3}),
    "length": ("m", {"m": 1.0, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "km": 1e3}),
    "velocity": (
        "m/s",
        {
            "m/s": 1.0,
            "mm/s": 1e-3,
            "cm/s": 1e-2,
            "km/h": 1.0 / 3.6,
            "um/s": 1e-6,
            "m/min": 1.0 / 60.0,
            "mm/min": 1e-3 / 60.0,
        },
    ),
    "acceleration": ("m/s^2", {"m/s^2": 1.0, "mm/s^2": 1e-3, "cm/s^2": 1e-2}),
    "frequency": ("Hz", {"Hz": 1.0, "kHz": 1e3}),
    "ratio": ("1", {"1": 1.0, "%": 1e-2}),
}
_SYNONYMS = {
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "radian": "rad",
    "radians": "rad",
    "degree": "deg",
    "degrees": "deg",
    "grad": "deg",
    "°": "deg",
    "°/s": "deg/s",
    "°/s^2": "deg/s^2",
    "turn": "rev",
    "r/min": "rpm",
    "rev/min": "rpm",
    "1/min": "rpm",
    "min^-1": "rpm",
    "U/min": "rpm",
    "RPM": "rpm",
    "volt": "V",
    "ampere": "A",
    "pct": "%",
    "percent": "%",
    "-": "1",
    "": "1",
}


def _key(text: str) -> str:
    """Normalise the spelling of a unit, so that N m, N*m, N·m and Nm are the same."""
    key = text.strip().replace("µ", "u").replace("μ", "u").replace("²", "^2").replace("**2", "^2")
    for sign in " *·⋅.":
        key = key.replace(sign, "")
    return key[:-1] + "^2" if key.endswith("/s2") else key


_UNITS = {
    _key(name): Unit(quantity, factor, si)
    for quantity, (si, members) in _TABLE.items()
    for name, factor in members.items()
}
_UNITS |= {_key(other): _UNITS[_key(name)] for other, name in _SYNONYMS.items()}


# A capital M before another capital stands for a million.
_FOLDED = {key.casefold(): unit for key, unit in _UNITS.items() if key[:1] != "m" or not key[1:2].isupper()}


def known_units(quantity: str | None = None) -> tuple[str, ...]:
    """List the known units of one quantity ("angle", "torque", ...), or of all."""
    tables = _TABLE.values() if quantity is None else (_TABLE[quantity],)
    return tuple(name for _, members in tables for name in members)


def parse_unit(text: str) -> Unit:
    """Look up a unit by name.

    Args:
        text: for example "deg/s", "mN m", "N*m", "ms".

    Raises:
        UnitError: the unit is unknown; the message lists the known ones.
    """
    key = _key(str(text))
    unit = _UNITS.get(key) or (_FOLDED.get(key.casefold()) if len(key) > 1 else None)
    if unit is None:
        raise UnitError(f'unknown unit "{text}"; known units: {", ".join(known_units())}')
    return unit


def usual_spelling(text: str) -> str:
    """The name under which `known_units` lists a unit: "deg" for "Grad" and "°".

    Raises:
        UnitError: the unit is unknown.
    """
    unit = parse_unit(text)
    return next(name for name in known_units(unit.quantity) if parse_unit(name) == unit)


def factor_between(unit: str, target: str) -> float:
    """Factor that converts values in `unit` to `target`.

    Raises:
        UnitError: a unit is unknown, or the two measure different quantities.
    """
    source, wanted = parse_unit(unit), parse_unit(target)
    if source.quantity != wanted.quantity:
        raise UnitError(
            f'unit "{unit}" measures {source.quantity}, expected {wanted.quantity}: '
            f"one of {', '.join(known_units(wanted.quantity))}"
        )
    return source.factor / wanted.factor
