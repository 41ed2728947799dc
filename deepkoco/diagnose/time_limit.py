"""Time limit of a diagnosis: which steps it leaves out once its time is over."""

from __future__ import annotations

import time
from collections.abc import Callable

Clock = Callable[[], float]


class TimeLimitError(ValueError):
    """A time limit cannot be used."""


class TimeLimit:
    """Time that a diagnosis may take, and the steps that it left out because that was over.

    The refit of the simulation and the first fits of the causes are always made, because there is no answer without
    them. Every later step asks before it begins. Without a limit, no result depends on a clock.

    Args:
        seconds: The limit [s]; None for none.
        clock: Seconds that have passed since some moment.
        began: When the time began, by the clock; None for now.

    Attributes:
        left_out: Steps that were not made, in words.

    Raises:
        TimeLimitError: The limit is not positive.
    """

    def __init__(
        self, seconds: float | None = None, clock: Clock = time.perf_counter, began: float | None = None
    ) -> None:
        if seconds is not None and not seconds > 0.0:
            raise TimeLimitError(f"a time limit of {seconds:g} s: give a positive number of seconds")
        self.seconds, self._clock = seconds, clock
        self._began = clock() if began is None else began
        self.left_out: list[str] = []

    @property
    def over(self) -> bool:
        """Whether the time is over."""
        return self.seconds is not None and self._clock() - self._began >= self.seconds

    @property
    def left(self) -> float | None:
        """Time that is left [s], positive; None without a limit."""
        return None if self.seconds is None else max(self.seconds - (self._clock() - self._began), 1e-3)

    def allows(self, step: str) -> bool:
        """Return whether a step may begin; one that may not is remembered as left out.

        Args:
            step: What would be left out, in words.
        """
        if not self.over:
            return True
        if step not in self.left_out:
            self.left_out.append(step)
        return False
