"""Pullbacks: from a node's traced function to the function that takes cotangents back from its outputs to its inputs.

A function y = f(x) has the pullback g = (df/dx)^T y_bar. The traced operations are run again under `torch.func.vjp`,
and what that does is traced in turn: so each operation has torch's own rule, and what the eager executor's gradients
do at a clamp, a tie or a `detach`, the kernel's do too.

What depends on the parameters alone is the same in all steps of a rollout. The trace is cut there: y = f(e(p), x).
The early part e is worked out once; the steps add up cotangents of its results, and the pullback of e runs once at
the end.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from deepkoco.graph.execution.fused.program import traced
from deepkoco.graph.execution.fused.trace import Call, Ref, Trace, leaves
from deepkoco.graph.execution.fused.value import REGISTERS

VALUE, COTANGENT, GRADIENT = "e.", "y.", "g."
"""Beginnings of names: of results of the early part, of cotangents that are given, and of those that are found."""
_TIMES = ("t_start", ".t_sent", ".t_received")
"""Ends of the names of inputs that come from the timing, which is fixed."""


@dataclass(frozen=True)
class Pullback:
    """The pullback of one function.

    Attributes:
        early: from parameters to the values "e.<number>" that the steps use.
        back: from the inputs of a step, "e.<number>" and the cotangents "y.<output>" to "g.<input>".
        early_back: from parameters and the cotangents "y.e.<number>" to "g.<parameter>".
    """

    early: Trace
    back: Trace
    early_back: Trace


def pullback(who: str, trace: Trace, early: Sequence[str]) -> Pullback:
    """Work out the pullback of a trace.

    Args:
        who: whose function it is, for messages.
        trace: the function, traced where gradients are wanted.
        early: names of the inputs that do not change during a rollout.

    Raises:
        TraceError: an operation cannot be differentiated.
    """
    early_calls, late_calls, values = _cut(trace, set(early))
    names = {f"{VALUE}{k}": ref for k, ref in enumerate(values)}
    given = {name: ref for name, ref in trace.inputs.items() if name in early}
    first = Trace(given, tuple(early_calls), dict(names))
    inputs = {name: ref for name, ref in trace.inputs.items() if name not in early or not _small(ref)}
    rest = Trace(inputs | names, tuple(late_calls), trace.outputs)
    return Pullback(first, _traced_back(who, rest), _traced_back(who, first))


def _cut(trace: Trace, early: set[str]) -> tuple[list[Call], list[Call], list[Ref]]:
    """Calls that depend on early inputs alone, the others, and what the others read of the first.

    Large tensors stay with the others: they are worked on in memory, and nothing would be saved.
    """
    known = {id(ref) for name, ref in trace.inputs.items() if name in early and _small(ref)}
    first, rest = [], []
    for call in trace.calls:
        tensors = leaves((call.arguments, call.options), Tensor)
        small = all(map(_small, call.outputs)) and all(value.numel() <= REGISTERS for value in tensors)
        if small and all(id(ref) in known for ref in call.reads()):
            known |= {id(ref) for ref in call.outputs}
            first.append(call)
        else:
            rest.append(call)
    read = [ref for call in rest for ref in call.reads()]
    read += [ref for ref in trace.outputs.values() if isinstance(ref, Ref)]
    return first, rest, list({id(ref): ref for ref in read if id(ref) in known}.values())


def _small(ref: Ref) -> bool:
    return ref.example.numel() <= REGISTERS


def _traced_back(who: str, trace: Trace) -> Trace:
    """The pullback of a trace as a trace."""
    numbers = [name for name, value in trace.outputs.items() if _differentiable(value)]
    examples = {name: ref.example for name, ref in trace.inputs.items()}
    examples |= {f"{COTANGENT}{name}": _example(trace.outputs[name]).clone() for name in numbers}
    moved = [
        name
        for name, ref in trace.inputs.items()
        if ref.example.is_floating_point() and not name.endswith(_TIMES)
    ]

    def function(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
        if not numbers or not moved:
            return {}
        fixed = {name: tensors[name] for name in trace.inputs if name not in moved}

        def forward(own: dict[str, Tensor]) -> dict[str, Tensor]:
            results = replay(trace, fixed | own)
            return {name: results[name] for name in numbers}

        _, back, *_ = torch.func.vjp(forward, {name: tensors[name] for name in moved})
        (found,) = back({name: tensors[f"{COTANGENT}{name}"] for name in numbers})
        return {f"{GRADIENT}{name}": value for name, value in found.items()}

    return traced(f"{who}, derivative", function, examples)


def replay(trace: Trace, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Run the operations of a trace again."""
    values = {id(ref): tensors[name] for name, ref in trace.inputs.items()}

    def value(item: Any) -> Any:
        if isinstance(item, Ref):
            return values[id(item)]
        if isinstance(item, tuple):
            return tuple(value(i) for i in item)
        return item

    for call in trace.calls:
        run: Any = _REPLAYED.get(call.name, call.function)
        result = run(*value(call.arguments), **{key: value(item) for key, item in call.options.items()})
        results = result if isinstance(result, (list, tuple)) else (result,)
        for ref, own in zip(call.outputs, results, strict=True):
            values[id(ref)] = own
    return {name: value(out) for name, out in trace.outputs.items()}


def _copy(x: Tensor, source: Tensor, *_: Any) -> Tensor:
    return source.to(x.dtype).expand(x.shape)


_REPLAYED: dict[str, Callable[..., Any]] = {"aten.copy.default": _copy}
"""Operations that a trace has in the place of others, which torch can differentiate."""


def _example(value: Ref | Tensor) -> Tensor:
    return value.example if isinstance(value, Ref) else value


def _differentiable(value: Ref | Tensor) -> bool:
    return isinstance(value, Ref) and value.example.is_floating_point()
