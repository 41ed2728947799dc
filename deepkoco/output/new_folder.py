"""Folders of results that appear whole or not at all, and never over another."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class FolderExistsError(FileExistsError):
    """A folder of results is there already, or cannot be made where it is asked for."""


def check_new(out: Path) -> None:
    """Refuse a folder that exists, or that a file on its path keeps from being made.

    Raises:
        FolderExistsError: It exists, or cannot be made.
    """
    blocked = next((parent for parent in out.parents if parent.exists() and not parent.is_dir()), None)
    if blocked is not None:
        raise FolderExistsError(f"{out}: {blocked} is no folder; choose another place")
    if out.exists():
        raise FolderExistsError(f"{out}: exists; choose another folder or move it away")


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Give a folder to write into; it gets its name when all is written, and is gone after an error.

    Raises:
        FolderExistsError: The name is taken.
    """
    check_new(out)
    partial = out.with_name(f".{out.name}.{os.getpid()}.partial")
    partial.mkdir(parents=True)
    try:
        yield partial
        os.rename(partial, out)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
