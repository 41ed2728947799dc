"""Seeds of a vector environment: one for all environments, or one for each as in Gymnasium's own vector form."""

from __future__ import annotations

import operator
from collections.abc import Sequence

import numpy as np

Seeds = int | Sequence[int | None] | None
"""What `reset` takes: one seed, one for each environment (None: goes on with its draws), or none."""


def read_seeds(seed: Seeds, environments: int) -> int | tuple[int | None, ...] | None:
    """Check seeds; a list of nothing but None is None.

    Args:
        seed: One for all, or one for each.
        environments: Environments B.

    Raises:
        ValueError: The list has another length.
        TypeError: A seed is no integer.
    """
    if seed is None or isinstance(seed, (int, np.integer)):
        return None if seed is None else int(seed)
    each = tuple(None if own is None else operator.index(own) for own in seed)
    if len(each) != environments:
        raise ValueError(f"seed: {len(each)} seeds for {environments} environments; give one for each")
    return None if all(own is None for own in each) else each


def split_seeds(seed: Seeds, environments: int, mask: np.ndarray | None) -> tuple[int | None, dict[int, int]]:
    """What a reset draws jointly, and who has a seed of its own.

    Args:
        seed: As for `reset`.
        environments: Environments B.
        mask: (B,) bool, who starts; None: all.

    Returns:
        Seed of all other draws, None to go on with those of before; by place in the batch, seeds of its own.
    """
    read = read_seeds(seed, environments)
    if not isinstance(read, tuple):
        return read, {}
    own = {place: s for place, s in enumerate(read) if s is not None and (mask is None or mask[place])}
    return joint_seed(read) if None not in read and mask is None else None, own


def joint_seed(seeds: Sequence[int | None]) -> int:
    """One seed that follows from those of all environments."""
    words = [0 if own is None else own + 1 for own in seeds]
    return int(np.random.SeedSequence(words).generate_state(1, np.uint64)[0] >> 1)


def without_gaps(seed: Seeds) -> int | Sequence[int] | None:
    """Seeds for draws that all environments share: a list with None in it becomes one seed."""
    if seed is None or isinstance(seed, (int, np.integer)):
        return seed if seed is None else int(seed)
    known = [own for own in seed if own is not None]
    if len(known) == len(seed):
        return known
    return joint_seed(seed) if known else None
