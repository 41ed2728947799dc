"""Rings: the last outputs of the nodes while a pass runs, and what masks keep."""

from collections.abc import Mapping

import torch
from torch import Tensor

from deepkoco.graph.model.node import GraphError, Node, State


class Cells:
    """The rings while a pass runs; one is copied before it is written for the first time.

    Args:
        rings: by node name, (cells, B, ...).
        depth: by node name, cells that are read.
        environment: (B,) int64, 0 to B - 1.
    """

    def __init__(self, rings: Mapping[str, Tensor], depth: Mapping[str, int], environment: Tensor) -> None:
        self.rings, self.depth = dict(rings), depth
        self._environment = environment
        self._owned: set[str] = set()

    def write(
        self, name: str, cell: Tensor, mask: Tensor | None, output: Tensor, *, grow: bool = False
    ) -> None:
        """Put outputs (B, ...) into cells (B,), or nowhere where the mask says so."""
        ring = self.rings[name]
        if grow and output.dtype != ring.dtype:  # the initial output may be of another type
            ring = self.rings[name] = ring.to(output.dtype)
        if output.dtype != ring.dtype or output.shape != ring.shape[1:]:
            raise GraphError(
                f'node "{name}": initial output {ring.dtype} {tuple(ring.shape[1:])}, output {output.dtype} '
                f"{tuple(output.shape)}; a compiled executor needs them alike"
            )
        if self.depth[name] == 1:
            self.rings[name] = keep(mask, output, ring[0]).unsqueeze(0)
            return
        if name not in self._owned:
            self._owned.add(name)
            ring = self.rings[name] = ring.clone()
        ring.index_put_((cell, self._environment), output)


def merged(node: Node, mask: Tensor | None, new: State, old: State) -> State:
    """A node's new state where the mask (B,) says so (None: everywhere), else the old one."""
    for key, value in old.items():
        if key not in new or new[key].dtype != value.dtype or new[key].shape != value.shape:
            became = f"{new[key].dtype} {tuple(new[key].shape)}" if key in new else "nothing"
            raise GraphError(
                f'node "{node.name}": state "{key}" {value.dtype} {tuple(value.shape)} becomes {became}; '
                "a compiled executor needs them alike"
            )
    return {key: keep(mask, new[key], value) for key, value in old.items()}


def keep(mask: Tensor | None, new: Tensor, old: Tensor) -> Tensor:
    """Numbers (B, ...) from `new` where the mask (B,) says so (None: everywhere), else from `old`."""
    if mask is None or new is old:
        return new
    return torch.where(mask.reshape(-1, *(1,) * (old.ndim - 1)), new, old)
