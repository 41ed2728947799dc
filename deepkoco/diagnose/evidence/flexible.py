"""Causes that can fit the residuals of other causes: pushes, tones and detents."""

from __future__ import annotations

BENDING = ("cogging", "periodic")  # lasting causes
PUSHES = ("event", "body_push")
FLEXIBLE_CAUSES = (*PUSHES, *BENDING)
