"""Files that appear whole or not at all, and one sentence where the disk does not take them."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

REMEDIES = {
    errno.ENOSPC: "free some space or choose a place on another disk",
    errno.EDQUOT: "free some space of your quota or choose a place on another disk",
    errno.EFBIG: "raise the limit on the size of files (ulimit -f) or choose another disk",
    errno.EROFS: "choose a place that can be written",
    errno.EACCES: "choose a place that you may write to, or change its permissions",
    errno.EPERM: "choose a place that you may write to, or change its permissions",
    errno.ENOTDIR: "choose a place in a folder",
    errno.ENOENT: "make the folder first",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.EIO: "check the disk, or choose a place on another one",
}
"""What the user can do, by error number of the system."""


DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
"""What only a disk says, whatever else went wrong behind it."""


class WriteError(OSError):
    """A file or folder cannot be written; the message names it, the cause and the remedy."""

    def __init__(self, path: str | Path, cause: OSError) -> None:
        remedy = REMEDIES.get(cause.errno or 0, "choose another place")
        reason = os.strerror(cause.errno or 0)
        super().__init__(f"{path}: cannot be written: {reason[:1].lower()}{reason[1:]}; {remedy}")
        self.errno, self.path, self.cause = cause.errno, Path(path), cause


def system_error(error: OSError) -> str:
    """Say in one sentence which file the system refused, and why."""
    if isinstance(error, WriteError) or error.filename is None:
        return error.strerror or str(error)
    reason = error.strerror or type(error).__name__
    return f"{os.fsdecode(error.filename)}: {reason[:1].lower()}{reason[1:]}"


@contextmanager
def writing(path: str | Path, beside: str | Path | None = None) -> Iterator[None]:
    """Turn what the system says while a file or folder is written into a `WriteError`.

    Args:
        path: What is written, as the user knows it.
        beside: File or folder that is written in its place until it is whole; None takes `path`.

    Raises:
        WriteError: The system refused to write `path`, `beside`, or something in it.
    """
    own = Path(path if beside is None else beside)
    try:
        yield
    except WriteError as error:
        if error.path.is_relative_to(own):  # the user knows the place by its final name
            raise WriteError(path, error.cause) from error
        raise
    except OSError as error:
        # A write that fails names no file. An error that names one is ours only if it is about this place.
        named = [Path(n) for n in (error.filename, error.filename2) if isinstance(n, str | os.PathLike)]
        ours = [name for name in named if own.is_relative_to(name) or name.is_relative_to(own)]
        if error.errno is None or (named and not ours):
            raise
        raise WriteError(path, error) from error
    except Exception as error:
        # Some libraries (torch.save) put an error of their own in the place of the system's.
        cause = error.__context__
        while cause is not None and not (isinstance(cause, OSError) and cause.errno in DISK):
            cause = cause.__context__
        if not isinstance(cause, OSError):
            raise
        raise WriteError(path, cause) from error


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Give a file to write in the place of another, which it replaces when all is written.

    The ending of the name stays, because writers choose their format by it. A program that stops or fails in
    the middle leaves what was there before.

    Args:
        path: File that is made or replaced.

    Yields:
        File to write, in the same folder.

    Raises:
        WriteError: The disk is full, or the place cannot be written.
    """
    path = Path(path)
    partial = path.with_name(f".partial-{os.getpid()}-{path.name}")
    try:
        with writing(path, partial):
            yield partial
            with partial.open("rb+") as file:
                # Some file systems tell only now that there is no room.
                os.fsync(file.fileno())
            os.replace(partial, path)
    finally:
        # On a read-only disk this fails too, and the user is to hear of the first failure.
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def write_whole_text(path: str | Path, text: str) -> None:
    """Write a text file, UTF-8, whole or not at all.

    Raises:
        WriteError: The disk is full, or the place cannot be written.
    """
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
