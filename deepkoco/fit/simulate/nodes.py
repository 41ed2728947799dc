"""States of a simulation at the nodes of its integration steps."""

from typing import NamedTuple

from torch import Tensor


class Nodes(NamedTuple):
    """States and derivatives at the n + 1 nodes of the integration steps; lanes are the last axis.

    The derivatives before and after a node differ if a command jumps there.

    Attributes:
        value: Per state (n + 1, W, L).
        left: Per state (n, W, L), derivative at the start of each step.
        right: Per state (n, W, L), derivative at the end of each step.
    """

    value: tuple[Tensor, ...]
    left: tuple[Tensor, ...]
    right: tuple[Tensor, ...]
