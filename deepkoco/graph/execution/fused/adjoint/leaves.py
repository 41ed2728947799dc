"""The numbers of a fused state as tensors, through which gradients pass from one rollout to the next.

Leaves are states ("s", node, name), last outputs ("o", node), oldest first, and readings ("r", name), (B, ...) each.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from operator import attrgetter
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from deepkoco.graph.execution import cells
from deepkoco.graph.execution.fused.adjoint.tape import Layout
from deepkoco.graph.execution.fused.kernel import Kernel
from deepkoco.graph.execution.fused.record import Field, Records
from deepkoco.graph.execution.fused.state import FusedState, Leaves
from deepkoco.graph.execution.state import RuntimeState

Key = tuple[str, ...]
END: Key = ("e",)
"""Name of what stands for a state."""


def leaves_of(kernel: Kernel, state: RuntimeState, fresh: bool) -> Leaves:
    """Leaves of a plain state.

    Args:
        kernel: says what each node puts out.
        state: plain.
        fresh: nothing has run yet.
    """
    found: dict[Key, Tensor] = {}
    for position, (node, program) in enumerate(zip(kernel.graph.nodes, kernel.programs, strict=True)):
        for key, value in state.nodes[node.name].items():
            if value.is_floating_point():
                found["s", node.name, key] = value
        if not program.output[0].is_floating_point:
            continue
        own = state.outputs[node.name]
        if all(cell is own[0] for cell in own):
            history = own[0].unsqueeze(1).expand(len(own[0]), len(own), *own[0].shape[1:])
        else:
            ran = state.schedule.executed[state.row, state.step, position].astype(np.int64)
            history = cells.rotate(torch.stack(own, 1), np.zeros_like(ran) if fresh else ran)
        found["o", node.name] = history.to(program.output[0])
    found |= {("r", name): value for name, value in state.readings.items() if value.is_floating_point()}
    return found


class LazyLeaves(Mapping[Key, Tensor]):
    """Leaves of the state after a rollout, unpacked when one of them is asked for.

    Args:
        state: after the rollout.
        layout: of its tape.
        end: stands for its records in the graph of gradients; its cotangent is a record of cotangents.
        before: leaves before the rollout, some of which it does not change.

    Attributes:
        kept: those that it has not changed.
    """

    def __init__(self, state: FusedState, layout: Layout, end: Tensor, before: Leaves) -> None:
        source = state.binding.kernel.source
        moving = [("s", *key) for key, field in source.moving.items() if field.dtype.is_floating_point]
        readings = [("r", name) for name, f in source.readings.items() if f.dtype.is_floating_point]
        self._keys: tuple[Key, ...] = (*moving, *(("o", name) for name in layout.histories), *readings)
        self.kept = {key: before[key] for key in before if key[0] == "s" and key not in moving}
        self._state, self._layout, self.end = state, layout, end
        self._found: dict[Key, Tensor] = {}
        self._filled: set[Key] = set()

    def inputs(self) -> dict[Key, Tensor]:
        """What the next rollout depends on: leaves, or what stands for most of them, which saves to unpack them.

        Cotangents from there and from the leaves are added up, so all numbers must be of one type.
        """
        if self._layout.numbers is None:
            return {key: self[key] for key in self if key[0] in "so"}
        return {**self.kept, END: self.end}

    @property
    def requires_grad(self) -> bool:
        """Whether any of them does."""
        return self.end.requires_grad or any(value.requires_grad for value in self.kept.values())

    def __getitem__(self, key: Key) -> Tensor:
        if key in self.kept:
            return self.kept[key]
        if key not in self._keys:
            raise KeyError(key)
        if not self._found:
            values = _Unpack.apply(self.end, self._state, self._layout, self._keys)
            self._found = dict(zip(self._keys, values, strict=True))
        if key not in self._filled:
            self._filled.add(key)
            self._found[key].detach().copy_(self._numbers(key))
        return self._found[key]

    def _numbers(self, key: Key) -> Tensor:
        state, records = self._state, self._state.records[1]
        if key[0] == "o":
            return _history(state, self._layout, records, key[1])
        return records.unpack(moving_field(state, key), state.place.lane_of)

    def __contains__(self, key: object) -> bool:
        return key in self.kept or key in self._keys

    def __iter__(self) -> Iterator[Key]:
        return iter((*self.kept, *self._keys))

    def __len__(self) -> int:
        return len(self.kept) + len(self._keys)


class _Unpack(torch.autograd.Function):
    """From records to leaves, not yet filled; as its derivative, from their cotangents to a record of cotangents."""

    @staticmethod
    def forward(
        ctx: Any, end: Tensor, state: FusedState, layout: Layout, keys: tuple[Key, ...]
    ) -> tuple[Tensor, ...]:
        ctx.set_materialize_grads(False)
        ctx.state, ctx.layout, ctx.keys = state, layout, keys
        fields = [layout.histories[k[1]] if k[0] == "o" else moving_field(state, k) for k in keys]
        return tuple(torch.empty(state.batch, *field.shape, dtype=field.dtype) for field in fields)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        state, layout = ctx.state, ctx.layout
        blocks, lanes = state.binding.blocks, state.binding.kernel.lanes
        buffer = np.zeros((blocks, lanes * layout.record_size), dtype=np.uint8)
        records = Records(buffer, lanes)
        for key, grad in zip(ctx.keys, grads, strict=True):
            if grad is not None:
                field = layout.histories[key[1]] if key[0] == "o" else moving_field(state, key)
                records.pack(field, grad, state.place.source)
        return as_cotangent(buffer, layout), None, None, None


def as_cotangent(records: np.ndarray, layout: Layout) -> Tensor:
    """Records of cotangents (blocks, bytes) as the cotangent of what stands for the state."""
    return torch.from_numpy(records.reshape(-1)).view(layout.numbers or torch.float64)


def moving_field(state: FusedState, key: Key) -> Field:
    """Where a state or a reading lies in the moving record."""
    if key[0] == "s":
        return state.binding.kernel.source.moving[key[1], key[2]]
    return state.binding.readings[key[1]]


def _history(state: FusedState, layout: Layout, records: Records, name: str) -> Tensor:
    """The last outputs (B, depth, ...) of a node, oldest first."""
    graph, ring = state.binding.kernel.graph, state.binding.rings[name]
    position, field, lane_of = graph.index[name], layout.histories[name], state.place.lane_of
    depth, *shape = field.shape
    executed = state.schedule.executed[state.row, state.step, position].astype(np.int64)
    places = (executed[:, None] - depth + np.arange(depth)) % ring.cells
    every = records.unpack(Field(field.dtype, (ring.cells, *shape), ring.offset), lane_of)
    if (places == places[0]).all():
        return every[:, places[0].tolist()]
    return every[torch.arange(len(places))[:, None], torch.from_numpy(places)]


_REQUIRES_GRAD = attrgetter("requires_grad")


def wants_gradients(state: RuntimeState, *more: Tensor | None) -> bool:
    """Whether a gradient is wanted with respect to anything in a state, or to further tensors."""
    if not torch.is_grad_enabled():
        return False
    for value in more:
        if value is not None and value.requires_grad:
            return True
    # A state of this executor has its parameters in one list; asking each one in Python takes as long as a step.
    own = getattr(state, "changing", None)
    if any(map(_REQUIRES_GRAD, own)) if own is not None else _any(state.parameters.values()):
        return True
    leaves = getattr(state, "leaves", None)
    if isinstance(leaves, LazyLeaves):
        return leaves.requires_grad
    if leaves is not None:
        return any(value.requires_grad for value in leaves.values())
    # A state of this executor without leaves holds numbers alone.
    return type(state) is RuntimeState and (
        _any(state.nodes.values())
        or any(cell.requires_grad for own in state.outputs.values() for cell in own)
    )


def _any(values: Iterable[Mapping[str, Tensor]]) -> bool:
    return any(value.requires_grad for own in values for value in own.values())
