"""Whether tensors are plain numbers, which a compiled loop can read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor


def is_plain(values: Sequence[Tensor | float | None]) -> bool:
    """Whether values are float64 numbers on the CPU, without gradients and outside of a trace.

    The compiled loop reads memory: it can take nothing else.
    """
    gradients = torch.is_grad_enabled()
    for value in values:
        if isinstance(value, Tensor) and (
            type(value) is not Tensor
            or value.dtype != torch.float64
            or not value.is_cpu
            or (gradients and value.requires_grad)
        ):
            return False
    return not _transformed()


def is_readable(value: Tensor) -> bool:
    """Whether Python may look at the values of a tensor: on the CPU, and outside of a trace."""
    return type(value) is Tensor and value.is_cpu and not _transformed()


def needs_gradient(values: Iterable[Tensor]) -> bool:
    """Whether gradients are wanted with respect to any of the values, backwards or forwards."""
    functorch = torch._C._functorch
    differentiates = (functorch.TransformType.Grad, functorch.TransformType.Jvp)
    if any(level.key() in differentiates for level in functorch.get_interpreter_stack() or ()):
        return True
    return torch.is_grad_enabled() and any(value.requires_grad for value in values)


def _transformed() -> bool:
    """Whether torch records or transforms operations: traces, vmap, functionalize."""
    return (
        torch._C._len_torch_dispatch_stack() > 0
        or torch._C._len_torch_function_stack() > 0
        or torch._C._functorch.peek_interpreter_stack() is not None  # pyright: ignore[reportAttributeAccessIssue]
        or torch.compiler.is_compiling()
        or torch.jit.is_tracing()  # pyright: ignore[reportPrivateImportUsage]
    )
