"""Rollouts that can be differentiated: a `torch.autograd.Function` around a kernel with a way back."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from deepkoco.graph.execution.fused.adjoint.kernel import PullStruct
from deepkoco.graph.execution.fused.adjoint.leaves import END, LazyLeaves, as_cotangent, moving_field
from deepkoco.graph.execution.fused.adjoint.tape import Layout, Tape
from deepkoco.graph.execution.fused.memory import Memory
from deepkoco.graph.execution.fused.record import Records
from deepkoco.graph.execution.fused.rollout import BlockCall, over_blocks
from deepkoco.graph.execution.fused.state import FusedState
from deepkoco.graph.execution.state import HorizonError

Key = tuple[str, ...]
ACTIONS: Key = ("a",)


def differentiable_rollout(
    state: FusedState, steps: int, record: tuple[str, ...], threads: int, *, actions: Tensor | None = None
) -> tuple[FusedState, dict[str, Tensor]]:
    """Take steps with given actions and keep what the way back needs.

    Args:
        state: with leaves, on a kernel with a way back.
        steps: how many; 0: from a reset to the first action.
        record: names of readings, and "action".
        threads: that share the blocks.
        actions: (steps, B or 1, M); None from a reset.

    Returns:
        The last state and (steps, B, ...) by name, all with gradients.

    Raises:
        HorizonError: the timing of an environment ends before; nothing has been done.
    """
    assert state.leaves is not None
    layout = _layout(state, steps)
    readings = tuple(name for name in record if name != "action")
    inputs = _inputs(state, actions)
    work = _Work(state, steps, readings, threads, actions, list(inputs), layout)
    *taken, end = _Rollout.apply(work, *inputs.values())
    found = dict(zip(readings, taken, strict=True))
    if actions is not None:
        found["action"] = actions.to(state.binding.action_type).expand(steps, *state.binding.action_shape)
    # Leaves that held the state that holds them would keep the tape until the next search for such circles.
    leaves = LazyLeaves(state.after(work.moving), layout, end, state.leaves)
    return state.after(work.moving, leaves), {name: found[name] for name in record}


def _layout(state: FusedState, steps: int) -> Layout:
    """The layout of tapes from this state; kept, because an optimiser starts from the same state again and again.

    Raises:
        HorizonError: see above.
    """
    if steps not in state.layouts:
        if steps:
            HorizonError.check(state, steps)
        state.layouts[steps] = Layout(state, steps, starts=steps == 0)
    return state.layouts[steps]


def _inputs(state: FusedState, actions: Tensor | None) -> dict[Key, Tensor]:
    """What a rollout depends on: parameters ("p", node, name), states and last outputs, and the actions."""
    source, leaves = state.binding.kernel.source, state.leaves
    assert leaves is not None
    given: dict[Key, Tensor] = {
        ("p", *key): state.parameters[key[0]][key[1]]
        for key, field in source.parameters.items()
        if field.dtype.is_floating_point
    }
    if isinstance(leaves, LazyLeaves):
        given |= leaves.inputs()
    else:
        given |= {key: leaves[key] for key in leaves if key[0] in "so"}
    return given if actions is None else {**given, ACTIONS: actions}


@dataclass
class _Work:
    """One rollout: what it does, where it began, and the tape that it leaves.

    Attributes:
        keys: names of what it depends on.
        moving: the records after it.
    """

    state: FusedState
    steps: int
    readings: tuple[str, ...]
    threads: int
    actions: Tensor | None
    keys: list[Key]
    layout: Layout

    def __post_init__(self) -> None:
        binding = self.state.binding
        self.moving, self.tape = binding.allocate(), Tape(self.layout, binding.spare)
        self.call = BlockCall(binding, self.steps, self.readings, self.actions)
        self.actions = None if self.actions is None else self.actions.detach()


class _Rollout(torch.autograd.Function):
    """The forward kernel, and as its derivative the way back over the tape.

    The last output stands for the records of the state after the rollout; its cotangent is a record of cotangents.
    """

    @staticmethod
    def forward(ctx: Any, work: _Work, *inputs: Tensor) -> tuple[Tensor, ...]:
        state, steps, binding = work.state, work.steps, work.state.binding
        kernel: Any = binding.kernel
        spent = over_blocks(
            binding,
            work.threads,
            lambda first, last, _: kernel.record(
                binding.model,
                state.fixed.address,
                state.moving.address,
                work.moving.address,
                work.call.part(first, last),
                work.tape.address,
            ),
        )
        if spent >= 0:
            raise HorizonError.of(spent, state.schedule, int(state.steps_left[spent]), steps)
        ctx.set_materialize_grads(False)
        ctx.work = work
        ctx.shapes = [(value.dtype, tuple(value.shape)) for value in inputs]
        # The work must not hold what is returned, which holds the work.
        taken = [work.call.taken.pop(name) for name in work.readings]
        ctx.mark_non_differentiable(*(value for value in taken if not value.is_floating_point()))
        kind = work.layout.numbers or torch.float64
        numbers = binding.blocks * kernel.lanes * work.layout.record_size // kind.itemsize
        return *taken, torch.zeros((), dtype=kind).expand(numbers)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        work: _Work = ctx.work
        state, layout, binding = work.state, work.layout, work.state.binding
        kernel: Any = binding.kernel
        *taken, end = grads
        given = [None if grad is None else grad.contiguous() for grad in taken]
        end = None if end is None else end.contiguous()
        pointers = np.array([0 if grad is None else grad.data_ptr() for grad in given], dtype=np.int64)
        begin = Memory(binding.blocks * kernel.lanes * layout.record_size)
        fixed = Memory(binding.blocks * kernel.lanes * binding.fixed_size)
        wanted, actions = ctx.needs_input_grad[1:], None
        if ACTIONS in work.keys and wanted[work.keys.index(ACTIONS)]:
            actions = torch.empty(work.steps, *binding.action_shape, dtype=binding.action_type)
        pull = PullStruct(
            readings=pointers.ctypes.data,
            end=None if end is None else end.data_ptr(),
            begin=begin.address,
            record_bytes=kernel.lanes * layout.record_size,
            fixed=fixed.address,
            actions=None if actions is None else actions.data_ptr(),
        )
        scratch = [Memory(layout.bar_size) for _ in range(work.threads)]

        def run(first: int, last: int, thread: int) -> int:
            kernel.reverse(
                binding.model,
                state.fixed.address,
                work.moving.address,
                work.call.part(first, last),
                work.tape.address,
                ctypes.addressof(pull),
                scratch[thread].address,
            )
            return -1

        over_blocks(binding, work.threads, run)
        find = _Found(work, begin, fixed, actions)
        return None, *(
            find(key, dtype, shape) if one else None
            for key, one, (dtype, shape) in zip(work.keys, wanted, ctx.shapes, strict=True)
        )


class _Found:
    """Gradients out of the records of cotangents.

    Args:
        work: the rollout.
        begin, fixed: records that were found.
        actions: (steps, B, M) gradient of the actions.
    """

    def __init__(self, work: _Work, begin: Memory, fixed: Memory, actions: Tensor | None) -> None:
        binding = work.state.binding
        self._work, self._actions = work, actions
        blocks, lanes = binding.blocks, binding.kernel.lanes
        self._begin, self._fixed = Records(begin.rows(blocks), lanes), Records(fixed.rows(blocks), lanes)
        self._sums: dict[torch.dtype, Tensor] = {}

    def __call__(self, key: Key, dtype: torch.dtype, shape: tuple[int, ...]) -> Tensor:
        """The gradient with respect to a tensor of this type and shape."""
        if key == ACTIONS:
            assert self._actions is not None
            shared = shape[1] == 1 and self._actions.shape[1] > 1
            return (self._actions.sum(1, keepdim=True) if shared else self._actions).to(dtype)
        state, source = self._work.state, self._work.state.binding.kernel.source
        if key == END:
            return as_cotangent(self._begin.buffer, self._work.layout)
        if key[0] == "o":
            return self._begin.unpack(self._work.layout.histories[key[1]], state.place.lane_of)
        place = key[1], key[2]
        field = (source.parameters if key[0] == "p" else source.fixed).get(place)
        if field is None:
            return self._begin.unpack(moving_field(state, key), state.place.lane_of)
        if not shape:
            whole = self._work.layout.shared[field.dtype]
            if field.dtype not in self._sums:
                self._sums[field.dtype] = self._fixed.unpack(whole, state.place.lane_of).sum(0)
            return self._sums[field.dtype][(field.offset - whole.offset) // field.size].reshape(())
        grad = self._fixed.unpack(field, state.place.lane_of)
        return grad.sum(0, keepdim=True) if shape[0] == 1 and len(grad) > 1 else grad
