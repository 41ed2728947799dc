"""One process a run: who trains in a folder holds its lock, which the system takes back when that process dies."""

from __future__ import annotations

import fcntl
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deepkoco.runs.settings import ExperimentError


@contextmanager
def locked(path: Path, wait: bool) -> Iterator[None]:
    """Hold the lock of a file, which must exist and is never replaced.

    Args:
        path: The file; it is not changed.
        wait: Wait for the process that holds it; else that is an error.

    Raises:
        ExperimentError: Another process holds it, and ``wait`` is False.
    """
    # Opened for writing, for NFS locks exclusively only what may be written.
    with path.open("r+b") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if not wait:
                raise ExperimentError(
                    f"{path.parent}: another process trains there now; wait for it or stop it"
                ) from None
            print(f"{path.parent}: another process trains there; waiting for it", file=sys.stderr, flush=True)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
