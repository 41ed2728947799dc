"""Say that functions are being compiled: after an installation this takes a minute, and once only."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

COMPILING = "compiling the simulation (about a minute, only after an installation)"


class _Outermost(event.Listener):
    """Calls a function when the first of nested compilations begins."""

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say, self._depth = say, 0

    def on_start(self, event: Any) -> None:
        if self._depth == 0:
            self._say(COMPILING)
        self._depth += 1

    def on_end(self, event: Any) -> None:
        self._depth -= 1


@contextmanager
def told_of_compilation(say: Callable[[str], object]) -> Iterator[None]:
    """Call ``say`` whenever a function is compiled that is not kept on disk yet.

    Args:
        say: Takes the text to show.
    """
    with event.install_listener("numba:compile", _Outermost(say)):
        yield
