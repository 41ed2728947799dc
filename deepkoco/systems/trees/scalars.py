"""Arithmetic on components that may be numbers or tensors: zeros and ones of a model cost nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from deepkoco.systems.trees.tree import Matrix

Scalar = Any
"""A float that is known beforehand, or a tensor (...)."""
Triple = tuple[Scalar, Scalar, Scalar]

ZERO: Triple = (0.0, 0.0, 0.0)


def _is(x: Scalar, number: float) -> bool:
    return isinstance(x, float) and x == number


def add(a: Scalar, b: Scalar) -> Scalar:
    """a + b."""
    if _is(a, 0.0):
        return b
    return a if _is(b, 0.0) else a + b


def sub(a: Scalar, b: Scalar) -> Scalar:
    """a - b."""
    if _is(b, 0.0):
        return a
    return -b if _is(a, 0.0) else a - b


def mul(a: Scalar, b: Scalar) -> Scalar:
    """a b; a known 0 wins over what is not finite."""
    if isinstance(b, float):
        a, b = b, a
    if isinstance(a, float):
        if a == 0.0:
            return 0.0
        if a == 1.0:
            return b
        if a == -1.0:
            return -b
    return a * b


def total(terms: Sequence[Scalar]) -> Scalar:
    """Sum of the terms."""
    result: Scalar = 0.0
    for term in terms:
        result = add(result, term)
    return result


def plus(a: Triple, b: Triple) -> Triple:
    """a + b."""
    return add(a[0], b[0]), add(a[1], b[1]), add(a[2], b[2])


def scaled(s: Scalar, a: Triple) -> Triple:
    """s a."""
    return mul(s, a[0]), mul(s, a[1]), mul(s, a[2])


def dot(a: Triple, b: Triple) -> Scalar:
    """Scalar product."""
    return add(add(mul(a[0], b[0]), mul(a[1], b[1])), mul(a[2], b[2]))


def cross(a: Triple, b: Triple) -> Triple:
    """Vector product a x b."""
    return (
        sub(mul(a[1], b[2]), mul(a[2], b[1])),
        sub(mul(a[2], b[0]), mul(a[0], b[2])),
        sub(mul(a[0], b[1]), mul(a[1], b[0])),
    )


def outward(rotation: Matrix, a: Triple) -> Triple:
    """Coordinates in the outer frame of a vector of the inner one."""
    return dot(rotation[0], a), dot(rotation[1], a), dot(rotation[2], a)


def inward(rotation: Matrix, a: Triple) -> Triple:
    """Coordinates in the inner frame of a vector of the outer one."""
    x, y, z = rotation
    return dot((x[0], y[0], z[0]), a), dot((x[1], y[1], z[1]), a), dot((x[2], y[2], z[2]), a)


def turned(cosine: Scalar, sine: Scalar, a: Triple) -> Triple:
    """Vector after a turn about z."""
    return sub(mul(cosine, a[0]), mul(sine, a[1])), add(mul(sine, a[0]), mul(cosine, a[1])), a[2]


def turned_back(cosine: Scalar, sine: Scalar, a: Triple) -> Triple:
    """Vector before a turn about z."""
    return add(mul(cosine, a[0]), mul(sine, a[1])), sub(mul(cosine, a[1]), mul(sine, a[0])), a[2]
