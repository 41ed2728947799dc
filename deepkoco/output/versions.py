"""Versions of the packages that a diagnosis comes from."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version


def versions() -> dict[str, str]:
    """Versions that a result depends on."""
    result = {"python": platform.python_version()}
    for package in ("deepkoco", "torch", "numpy", "scipy"):
        try:
            result[package] = version(package)
        except PackageNotFoundError:
            result[package] = "unknown"
    return result
