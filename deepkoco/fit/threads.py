"""Limit the threads of torch while many small tensors are computed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch use one thread inside the context; afterwards it uses as many as before.

    The tensors of a fit are small, so a second thread does not make it faster. On a machine with busy cores, several
    threads made a diagnosis ten times slower.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
