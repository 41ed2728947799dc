"""How functions that make no arrays are compiled: without the counts of who holds an array.

Each row that is taken from an array would raise and lower its count, which takes longer than the work on a row of
32 numbers.
"""

from __future__ import annotations

from typing import Any

UNCOUNTED: dict[str, Any] = {"error_model": "numpy", "nogil": True, "_nrt": False}
"""Options of ``numba.njit``."""

COUNTED: dict[str, Any] = {"error_model": "numpy", "nogil": True, "_nrt": True}
"""Options of functions that make arrays and are called by uncounted ones, whose options they would take otherwise."""
