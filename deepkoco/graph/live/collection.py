"""Garbage collection in real time: a full one looks at all that was imported, and stops the process for 0.1-0.4 s."""

import gc


def exempt_present() -> None:
    """Take all that exists now out of later collections, which then look only at what a run makes.

    For a process about to run in real time: PyTorch alone makes hundreds of thousands of objects that stay.
    """
    gc.collect()
    gc.freeze()


def include_again() -> None:
    """Undo `exempt_present`."""
    gc.unfreeze()
