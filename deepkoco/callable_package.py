"""Packages that are called like the function of their name: `deepkoco.diagnose(...)`, `deepkoco.fit(...)`."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class CallablePackage(ModuleType):
    """A package with a function of the package's own name; calling the package calls the function."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        return getattr(self, self.__name__.rpartition(".")[2])(*args, **options)


def make_callable(package: str) -> None:
    """Let a package be called.

    Args:
        package: Its `__name__`; it has a function of the same name.
    """
    sys.modules[package].__class__ = CallablePackage
