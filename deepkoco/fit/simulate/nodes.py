"""States of a simulation at the nodes of its integration steps."""

from typing import NamedTuple

from torch import Tensor


class Nodes(NamedTuple):
    """States at the n + 1 nodes of the steps and their derivatives; lanes are the last axis.

    Attributes:
        value: Per state (n + 1, W, L).
        left: Per state (n, W, L), derivative at the start of each step.
        right: Per state (n, W, L), derivative at its end: a command may jump at the node.
    """

    value: tuple[Tensor, ...]
    left: tuple[Tensor, ...]
    right: tuple[Tensor, ...]
