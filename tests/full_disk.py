"""A disk that takes no more, for tests of what is written: the system's limit on the size of files, for a while."""

from __future__ import annotations

import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let writes fail that go beyond `size` [bytes] of a file, as on a disk that is full.

    No bytecode is written meanwhile: Python keeps a compiled module of which only a part could be written, and every
    later import of the module fails.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    had, children = sys.dont_write_bytecode, os.environ.get("PYTHONDONTWRITEBYTECODE")
    sys.dont_write_bytecode, os.environ["PYTHONDONTWRITEBYTECODE"] = True, "1"
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = had
        if children is None:
            del os.environ["PYTHONDONTWRITEBYTECODE"]
        else:
            os.environ["PYTHONDONTWRITEBYTECODE"] = children


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Let nothing be written in a folder, for the administrator neither."""
    administrator = os.geteuid() == 0
    folder.chmod(0o555)
    if administrator:
        for parent in folder.parents[:-1]:
            if not parent.stat().st_mode & 0o001:  # the folders of temporary files are closed to other users
                parent.chmod(parent.stat().st_mode | 0o055)
        os.seteuid(65534)  # "nobody": the administrator may write everywhere
    try:
        yield
    finally:
        if administrator:
            os.seteuid(0)
        folder.chmod(0o755)


def everything_in(folder: Path) -> dict[str, bytes]:
    """All files below a folder, hidden ones included."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
