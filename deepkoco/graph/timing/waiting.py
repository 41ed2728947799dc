"""A progress bar for work that turns out to take long; nothing where nobody looks at a terminal."""

import sys
import time
from types import TracebackType
from typing import Any

PATIENCE = 1.0  # time after which the bar appears [s]


class Waiting:
    """Shows on stderr how far work is, from `PATIENCE` seconds on; quiet where stderr is no terminal.

        with Waiting("drawing delays", 256) as waiting:
            for part in parts:
                ...
                waiting.advance(len(part))

    Args:
        doing: what is done, in a few words.
        total: number of parts.
    """

    def __init__(self, doing: str, total: int) -> None:
        self.doing, self.total, self.done = doing, total, 0
        self._bar: Any = None
        self._begun = time.monotonic()

    def __enter__(self) -> "Waiting":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, parts: int) -> None:
        """Take note that some more parts are done."""
        self.done += parts
        if self._bar is None and self.done < self.total and self._long():
            self._bar = _make_bar()
            self._bar.start()
            self._task = self._bar.add_task(self.doing, total=self.total)
        if self._bar is not None:
            self._bar.update(self._task, completed=self.done)

    def _long(self) -> bool:
        return time.monotonic() - self._begun > PATIENCE and sys.stderr.isatty()


def _make_bar() -> Any:
    # Imported late: nobody waits for it where the work is short.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )
