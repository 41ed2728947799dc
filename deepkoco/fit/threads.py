"""Threads of a fit: one for torch, several for simulations."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar

import torch

_pool: ContextVar[ThreadPoolExecutor | None] = ContextVar("simulations", default=None)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch use one thread inside the context, and simulations as many as torch had; afterwards all is as before.

    The tensors of a fit are small, so a second thread does not make an operation of torch faster. On a machine with
    busy cores, several threads made a diagnosis ten times slower: each operation waits for the slowest of them.
    Simulations are long and wait for each other once. With ``OMP_NUM_THREADS=1`` there is one thread.
    """
    before = torch.get_num_threads()
    if before == 1 or _pool.get() is not None:
        yield
        return
    torch.set_num_threads(1)
    try:
        with ThreadPoolExecutor(before, "simulation", torch.set_num_threads, (1,)) as pool:
            token = _pool.set(pool)
            try:
                yield
            finally:
                _pool.reset(token)
    finally:
        torch.set_num_threads(before)


def in_parts(call: Callable[[int, int], None], count: int, most: int, alone: bool = False) -> None:
    """Call for equal parts of ``count`` items, inside :func:`one_thread` for several at once.

    The parts do not depend on the number of threads, and so neither does a bit of what is computed.

    Args:
        call: Takes the first item of a part, and the one behind its last. Calls must not depend on each other.
        count: Number of items.
        most: Largest number of items in one part.
        alone: Whether to make one call after the other.

    Raises:
        Exception: The first one of a call.
    """
    parts = math.ceil(count / most)
    edges = [count * k // parts for k in range(parts + 1)]
    at_once(lambda k: call(edges[k], edges[k + 1]), parts, alone)


def at_once(call: Callable[[int], None], count: int, alone: bool = False) -> None:
    """Make ``count`` calls, inside :func:`one_thread` several at once.

    Args:
        call: Takes the number of the call. Calls must not depend on each other.
        count: How many.
        alone: Whether to make one call after the other.

    Raises:
        Exception: The first one of a call.
    """
    pool = _pool.get()
    if pool is None or alone or count == 1:
        for k in range(count):
            call(k)
    else:
        for _ in pool.map(call, range(count)):
            pass
