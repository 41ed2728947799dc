"""Plain values of a file that somebody else may have written: checked before they are used."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray


def whole_number(value: Any, name: str, least: int) -> int:
    """Check a whole number.

    Args:
        value: As read.
        name: For the message.
        least: Smallest number allowed.

    Returns:
        The number.

    Raises:
        ValueError: It is no whole number, or smaller.
    """
    if type(value) is not int or value < least:
        raise ValueError(f"{name} = {str(value)[:50]!r}; it should be a whole number of at least {least}")
    return value


def number_above(value: Any, name: str, bound: float, equal: bool = False) -> float:
    """Check a number.

    Args:
        value: As read.
        name: For the message.
        bound: The number is above this.
        equal: It may also be equal to it.

    Returns:
        The number.

    Raises:
        ValueError: It is no finite number, or not above the bound.
    """
    if type(value) not in (int, float) or not abs(value) < 1e300 or not math.isfinite(value):
        raise ValueError(f"{name} = {str(value)[:50]!r}; it should be a number")
    if value < bound or (value == bound and not equal):
        raise ValueError(f"{name} = {value}; it should be {'at least' if equal else 'above'} {bound:g}")
    return float(value)


def weights(value: Any, name: str) -> float | NDArray[np.float64]:
    """Check the weight of actions.

    Args:
        value: As read: one number of at least 0, or one for each action.
        name: For the message.

    Returns:
        The number, or an array (M,).

    Raises:
        ValueError: One of them is no such number.
    """
    if not isinstance(value, list):
        return number_above(value, name, 0.0, equal=True)
    return np.array([number_above(entry, name, 0.0, equal=True) for entry in value], np.float64)


def weights_as_stored(weight: float | NDArray[np.float64]) -> float | list[float]:
    """What `weights` reads."""
    return weight.tolist() if isinstance(weight, np.ndarray) else weight


def text(value: Any, name: str) -> str:
    """Check a text.

    Args:
        value: As read.
        name: For the message.

    Returns:
        The text.

    Raises:
        ValueError: It is none.
    """
    if not isinstance(value, str):
        raise ValueError(f"{name} = {str(value)[:50]!r}; it should be a text")
    return value
