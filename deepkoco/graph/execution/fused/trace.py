"""Traces: the aten operations that a pure function runs on one environment.

The function is called once on tensors with a batch of one. What it does to them is taken down; what it
works out from anything else (attributes of a node, numbers) is a constant of the trace. Writing into views
is rewritten into operations that return new tensors, so that a trace has no side effects.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from deepkoco.graph.execution.executor import NotCompiledError


class TraceError(NotCompiledError):
    """A function cannot be compiled; the message names the operation that stands in the way."""


@dataclass(frozen=True, eq=False)
class Ref:
    """A tensor of the trace, known by what it was in the example."""

    example: Tensor


@dataclass(frozen=True)
class Call:
    """One operation: `arguments` with a `Ref` wherever a tensor depends on the inputs."""

    name: str
    function: Any
    arguments: tuple[Any, ...]
    options: dict[str, Any]
    outputs: tuple[Ref, ...]

    def reads(self) -> list[Ref]:
        """The tensors that it depends on."""
        return leaves((self.arguments, self.options), Ref)


@dataclass(frozen=True)
class Trace:
    """What a function does to its inputs.

    Attributes:
        inputs: by name.
        calls: in the order in which they ran.
        outputs: by name; a tensor that does not depend on the inputs is itself.
    """

    inputs: dict[str, Ref]
    calls: tuple[Call, ...]
    outputs: dict[str, Ref | Tensor]

    def used(self) -> set[str]:
        """Names of the inputs that any operation or output reads."""
        refs: set[int] = {id(value) for value in self.outputs.values()}
        for call in self.calls:
            refs |= {id(ref) for ref in call.reads()}
        return {name for name, ref in self.inputs.items() if id(ref) in refs}


_PYTHON_READS = {"numpy", "__array__", "tolist", "data_ptr", "__dlpack__", "untyped_storage"}
_VALUE_READS = ("aten._local_scalar_dense", "aten.item", "aten.is_nonzero", "aten.equal", "aten.nonzero")
_ALIASES = ("aten.detach.default", "aten.alias.default", "aten.lift_fresh.default", "aten.lift.default")
_DETACH = "aten.detach.default"


def trace(
    function: Callable[[dict[str, Tensor]], Mapping[str, Tensor]],
    examples: Mapping[str, Tensor],
    gradients: bool = False,
) -> Trace:
    """Run a function on examples and take down what it does.

    Args:
        function: pure, from named tensors to named tensors.
        examples: tensors (1, ...) by name; what counts is their shapes and types.
        gradients: keep `detach` as an operation of its own, because gradients end there.

    Raises:
        TraceError: the function looks at the values of tensors, draws random numbers, writes into its
            inputs or reads a tensor that requires gradients and is none of them.
    """
    recorder = _Recorder(examples, gradients, writing=False)
    outputs: Mapping[str, Tensor] = {}
    try:
        with torch.no_grad(), _Guard(), recorder:
            outputs = function(dict(examples))
    except Exception:
        if not recorder.wrote:
            raise
    if recorder.wrote:
        recorder = _Recorder(examples, gradients, writing=True)
        with torch.no_grad(), _Guard(), recorder:
            outputs = torch.func.functionalize(function)(dict(examples))
    return Trace(
        recorder.inputs,
        tuple(recorder.calls),
        {name: recorder.refs.get(id(value)) or value for name, value in outputs.items()},
    )


class _WritesError(Exception):
    """A function writes into a tensor. The trace of one that does not takes half the time."""


class _Guard(TorchFunctionMode):
    """Refuses to hand the memory of tensors to Python, where a trace cannot follow."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if getattr(func, "__name__", "") in _PYTHON_READS:
            raise TraceError(f"Tensor.{func.__name__}() takes values out of the tensors")
        return func(*args, **(kwargs or {}))


class _Recorder(TorchDispatchMode):
    def __init__(self, examples: Mapping[str, Tensor], gradients: bool, writing: bool) -> None:
        super().__init__()
        self.gradients, self.writing, self.wrote = gradients, writing, False
        self.inputs = {name: Ref(tensor) for name, tensor in examples.items()}
        self.refs: dict[int, Ref] = {id(ref.example): ref for ref in self.inputs.values()}
        self.calls: list[Call] = []
        self.alive: list[Tensor] = []

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False  # nothing to skip, and torch would import its compiler to do so, which takes a second

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        name, draws, reads, writes = _facts_of(func)
        if draws:
            raise TraceError(f"{name} draws random numbers; ask for noise: def step(..., *, noise)")
        if writes and not self.writing:
            self.wrote = True
            raise _WritesError
        tensors = leaves((args, kwargs), Tensor)
        known = [ref for leaf in tensors if (ref := self.refs.get(id(leaf))) is not None]
        if known and reads:
            raise TraceError(f"{name} takes a value out of a tensor; use torch.where instead of if")
        result = func(*args, **kwargs)
        if len(known) < len(tensors) and any(
            leaf.requires_grad and id(leaf) not in self.refs for leaf in tensors
        ):
            # A kernel would keep the numbers of today while training goes on.
            raise TraceError(
                f"{name} reads a tensor that requires gradients and is no argument; hand it over with the "
                "parameters, or freeze it with requires_grad_(False)"
            )
        if not known:
            return result
        if name in _ALIASES and not (self.gradients and name == _DETACH):
            self.refs[id(result)] = known[0]
            self.alive.append(result)  # so that no other tensor gets its id
            return result
        if writes:
            raise TraceError(f"{name} writes into an input")
        outputs = tuple(Ref(leaf) for leaf in leaves(result, Tensor))
        self.refs |= {id(ref.example): ref for ref in outputs}
        self.calls.append(Call(name, func, self._refer(args), self._refer(kwargs), outputs))
        return result

    def _refer(self, value: Any) -> Any:
        if isinstance(value, Tensor):
            return self.refs.get(id(value), value)
        if isinstance(value, (list, tuple)):
            return tuple(self._refer(item) for item in value)
        if isinstance(value, dict):
            return {key: self._refer(item) for key, item in value.items()}
        return value


@cache
def _facts_of(func: Any) -> tuple[str, bool, bool, bool]:
    """Name of an operation, and whether it draws random numbers, takes values out of tensors, writes into them."""
    name = str(func)
    draws = torch.Tag.nondeterministic_seeded in func.tags
    return name, draws, name.startswith(_VALUE_READS), func._schema.is_mutable


def leaves(value: Any, kind: type) -> list[Any]:
    """All objects of one type in nested lists, tuples and dicts."""
    if isinstance(value, kind):
        return [value]
    if isinstance(value, dict):
        value = tuple(value.values())
    if isinstance(value, (list, tuple)):
        return [leaf for item in value for leaf in leaves(item, kind)]
    return []
