"""Tests with wall-clock limits, which a machine that does other work cannot keep."""

import functools
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ATTEMPTS = 6
PERIOD = 0.002  # at which a thread looks at the clock [s]
LATE = 0.02  # [s]; on a machine with an idle core such a thread is late by 1 ms


class Waiting:
    """Measures for how long at most a thread that is ready to run was kept waiting.

    Attributes:
        longest: That time so far [s].
    """

    def __init__(self) -> None:
        self.longest = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> "Waiting":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._over.is_set():
            due = time.monotonic() + PERIOD
            time.sleep(PERIOD)
            self.longest = max(self.longest, time.monotonic() - due)


def busy() -> bool:
    """Whether more processes want to run than there are cores.

    What a test starts in another process is late then, and no thread of this one need be: the system wakes whoever
    slept before whoever works.
    """
    return os.getloadavg()[0] > (os.cpu_count() or 1)


def on_time(test: Callable[..., None]) -> Callable[..., None]:
    """Repeat a test that fails while processes or threads of this one were kept waiting; such a failure says nothing.

    A failure on a machine with time for the test counts at once, and so does the last of six.
    """

    @functools.wraps(test)
    def run(**arguments: Any) -> None:
        for attempt in range(1, ATTEMPTS + 1):
            own = dict(arguments)
            if "tmp_path" in own:
                own["tmp_path"] = Path(own["tmp_path"]) / str(attempt)
                own["tmp_path"].mkdir()
            with Waiting() as waiting:
                try:
                    test(**own)
                except (Exception, pytest.fail.Exception):
                    if attempt == ATTEMPTS or (waiting.longest < LATE and not busy()):
                        raise
                else:
                    return

    return run
