"""Calls that are given up when they take too long."""

import queue
from collections.abc import Callable
from threading import Thread
from typing import Any


class StuckError(TimeoutError):
    """A call has not returned in time."""


class Watched:
    """Runs calls, one after the other, in a thread of its own that can be left behind.

    Python cannot end a thread from outside: one that does not return stays until the process ends.

    Args:
        limit: longest call [s].
    """

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self.stuck = False
        self._calls: queue.SimpleQueue[Callable[[], Any] | None] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[tuple[Any, BaseException | None]] = queue.SimpleQueue()
        Thread(target=self._serve, name="simulated nodes", daemon=True).start()

    def call(self, function: Callable[[], Any], limit: float | None = None) -> Any:
        """Run a function and return what it returns, or raise what it raises.

        Raises:
            StuckError: it takes longer than the limit.
        """
        self._calls.put(function)
        limit = self.limit if limit is None else limit
        try:
            result, error = self._results.get(timeout=limit)
        except BaseException as reason:  # also Ctrl-C: the call still runs
            self.stuck = True
            if isinstance(reason, queue.Empty):
                raise StuckError(f"has not returned for {limit:g} s") from None
            raise
        if error is not None:
            raise error
        return result

    def end(self) -> None:
        """Let the thread end when its call has."""
        self._calls.put(None)

    def _serve(self) -> None:
        while (function := self._calls.get()) is not None:
            try:
                self._results.put((function(), None))
            except BaseException as error:
                self._results.put((None, error))
