"""Which cases of a test run in every `make test`, and which in `make study` only."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def studied(cases: Iterable[Any], quick: Collection[Any]) -> list[Any]:
    """Mark all cases but a few for the study.

    Args:
        cases: Cases of one parametrized test.
        quick: Those that run in every test.
    """
    cases = list(cases)
    assert set(quick) <= set(cases)
    return [case if case in quick else pytest.param(case, marks=pytest.mark.study) for case in cases]
