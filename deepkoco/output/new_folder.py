"""Folders of results that appear whole or not at all, and never over another."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile

from deepkoco.output.whole_file import writing


class FolderExistsError(FileExistsError):
    """A folder of results is there already, or cannot be made where it is asked for."""


def check_new(out: Path) -> None:
    """Refuse a folder that exists or cannot be made, before the work whose results it is to hold.

    Raises:
        FolderExistsError: It exists, or a file on its path keeps it from being made.
        WriteError: The disk is full, or the place cannot be written.
    """
    blocked = next((parent for parent in out.parents if parent.exists() and not parent.is_dir()), None)
    if blocked is not None:
        raise FolderExistsError(f"{out}: {blocked} is no folder; choose another place")
    if out.exists():
        raise FolderExistsError(f"{out}: exists; choose another folder or move it away")
    check_writable(out)


def check_writable(out: Path) -> None:
    """Write and remove a file in the nearest folder above `out` that is there.

    Raises:
        WriteError: The folder takes no file.
    """
    above = next(parent for parent in out.absolute().parents if parent.is_dir())
    with writing(out, above), NamedTemporaryFile(dir=above, prefix=f".{out.name}.") as file:
        file.write(b"0")
        file.flush()


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Give a folder to write into; it gets its name when all is written, and is gone after an error.

    Raises:
        FolderExistsError: The name is taken.
        WriteError: The disk is full, or the place cannot be written.
    """
    check_new(out)
    partial = out.with_name(f".{out.name}.{os.getpid()}.partial")
    try:
        with writing(out, partial):
            partial.mkdir(parents=True)
            yield partial
            os.rename(partial, out)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
