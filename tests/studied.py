"""Which cases of a test run in every `make test`, which in `make study` only, and which in `make long`."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def studied(cases: Iterable[Any], quick: Collection[Any], rare: Collection[Any] = ()) -> list[Any]:
    """Mark all cases but a few for the study.

    Args:
        cases: Cases of one parametrized test.
        quick: Those that run in every test.
        rare: Those that run with the longest only.
    """
    cases = list(cases)
    assert {*quick, *rare} <= set(cases)
    study, long = (pytest.mark.study,), (pytest.mark.study, pytest.mark.long)
    return [
        case if case in quick else pytest.param(case, marks=long if case in rare else study) for case in cases
    ]
