"""Numbers with units as people write them: 0.036 mm, not 3.6e-05 m."""

from __future__ import annotations

import math
from collections.abc import Sequence

_SCALED = ("m", "s", "rad", "N", "V", "A", "m/s", "rad/s")
_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"))


def readable(value: float, unit: str, digits: int = 3) -> str:
    """A number with its unit, "1.5 N m", "0.036 mm", "20 ms"; no unit for the unit "1".

    Args:
        value: The number.
        unit: SI unit as text.
        digits: Significant digits.
    """
    text, unit = in_one_unit([value], unit, digits)
    return f"{text[0]} {unit}".strip()


def in_one_unit(values: Sequence[float], unit: str, digits: int = 3) -> tuple[list[str], str]:
    """Numbers that are compared, all in the unit that suits the largest.

    Args:
        values: The numbers; those that are not finite are no help in the choice.
        unit: SI unit as text.
        digits: Significant digits of each.

    Returns:
        The numbers as text, and the unit.
    """
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    factor, name = _scale(largest, unit)
    return [plain(v / factor, digits) for v in values], "" if unit == "1" else name


def telling_digits(low: float, high: float, least: int = 4, most: int = 9) -> int:
    """Significant digits with which an interval shows its width, by two digits: 0.8797 to 0.8803, not 0.88 to 0.88.

    Args:
        low, high: Its ends.
        least: Digits of a wide interval.
        most: Digits of a narrow one, and where there is no interval.
    """
    size, width = max(abs(low), abs(high)), high - low
    if not (math.isfinite(size) and width > 0.0):
        return least
    return min(max(least, 2 + math.floor(math.log10(size)) - math.floor(math.log10(width))), most)


def rounded(value: float) -> str:
    """A number with three digits or all before the point, and never a power of ten between 0.001 and a million."""
    if value != 0.0 and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.2e}"
    digits = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2 if abs(value) >= 1 else 3
    return f"{value:.{digits}f}"


def _scale(largest: float, unit: str) -> tuple[float, str]:
    if unit == "kg" and 0.0 < largest < 0.1:
        return 1e-3, "g"
    if (unit in _SCALED or unit.startswith("N ")) and 0.0 < largest < 0.1:
        for factor, prefix in _PREFIXES[1:]:
            if largest >= 0.1 * factor:
                return factor, prefix + unit
        return _PREFIXES[-1][0], _PREFIXES[-1][1] + unit
    return 1.0, unit


def plain(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, with powers of ten only where it could not be read else."""
    if not math.isfinite(value):
        return "unknown" if math.isnan(value) else "infinite" if value > 0 else "-infinite"
    if value == 0.0:
        return "0"
    if not 1e-5 <= abs(value) < 1e7:
        mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
        return f"{mantissa}·10^{int(exponent)}"
    behind = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    text = f"{value:,.{behind}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def less(before: float, after: float) -> str:
    """How an error has changed: "360 times less", "25 % less", "12 % more"."""
    if not (before > 0.0 and after > 0.0):
        return "no comparison"
    if before == after:
        return "the same"
    larger, smaller = max(before, after), min(before, after)
    word = "less" if after < before else "more"
    if larger >= 2.0 * smaller:
        return f"{plain(_rounded(larger / smaller, 2), 2)} times {word}"
    return f"{100.0 * abs(after / before - 1.0):.0f} % {word}"


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")
