"""Bodies: the C++ statements of one function, written one after the other.

A value is a vector over the lanes (environments) of a block for each of its elements. Values of up to
`REGISTERS` elements are names of variables, so that rearranging them costs nothing; larger ones lie in
memory and are worked on in loops. What depends on the parameters alone goes into a prologue that runs once
for a whole rollout.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.fused.trace import TraceError
from deepkoco.graph.execution.fused.value import (
    REGISTERS,
    VECTORS,
    Array,
    Value,
    contiguous,
    flat_indices,
    loops_over,
    number_text,
    position,
    supported,
)

_NAME = re.compile(r"\bv\d+\b")
_NUMBER = re.compile(r"splat<V\w>\([^()]*\)")
_LATE = re.compile(r"\b([ak]\d+|[SXQTAR])\b")
"""Arrays and arguments that the prologue does not have."""


class Body:
    """Collects the statements of a function; equal expressions are worked out once.

    Args:
        name: of the function.
        folds: leave out sums with 0 and products with 0 or 1, of which derivatives are full, and divide by taking
            reciprocals. A sum of -0 and 0 may then be -0, a product of 0 and infinity is 0, and a last bit may differ.

    Attributes:
        prologue, lines: statements that depend on parameters alone, and the others.
        shared: large constants, by name of the array in the kernel's pool.
        bytes: of the local arrays, per lane.
    """

    def __init__(self, name: str, folds: bool = False) -> None:
        self.name, self.folds = name, folds
        self.lines: list[str] = []
        self.prologue: list[str] = []
        self.shared: dict[str, Tensor] = {}
        self._known: dict[tuple[str, str], str] = {}
        self._early: dict[str, tuple[torch.dtype, str | None]] = {}
        self._places: dict[str, str] = {}  # where the prologue leaves values
        self._count = 0
        self.bytes = 0

    def fresh(self, letter: str = "a") -> str:
        """A name that is not used yet."""
        self._count += 1
        return f"{letter}{self._count}"

    def emit(self, dtype: torch.dtype, expression: str) -> str:
        """Add a variable with the value of an expression of others and return its name."""
        if _NAME.fullmatch(expression) or (self.folds and _NUMBER.fullmatch(expression)):
            return expression
        key = VECTORS[dtype], expression
        if key not in self._known:
            name = self._known[key] = self.fresh("v")
            operands = _NAME.findall(expression)
            early = bool(operands) and all(operand in self._early for operand in operands)
            early = early and _LATE.search(expression) is None
            if early:
                self._early[name] = (dtype, None)
            target = self.prologue if early else self.lines
            target.append(f"const {key[0]} {name} = {expression};")
        return self._known[key]

    def parameter(self, dtype: torch.dtype, expression: str) -> str:
        """Add a load of a parameter: known before the first step."""
        key = VECTORS[dtype], expression
        if key not in self._known:
            name = self._known[key] = self.fresh("v")
            self._early[name] = (dtype, expression)
        return self._known[key]

    def quotient(self, a: str, b: str, dtype: torch.dtype) -> str:
        """C++ of a / b; of what is known before the first step, the reciprocal is taken once."""
        if self.folds and a == self.literal(0, dtype):
            return a
        if self.folds and (_NAME.fullmatch(b) or _NUMBER.fullmatch(b)):
            # The derivative of a quotient divides by the same number several times.
            return self.product(a, self.emit(dtype, f"(1 / {b})"), dtype)
        early = b in self._early and not (a in self._early or a.startswith("splat"))
        return f"({a} * {self.emit(dtype, f'(1 / {b})')})" if early else f"({a} / {b})"

    def sum(self, a: str, b: str, dtype: torch.dtype, sign: str = "+") -> str:
        """C++ of a + b or a - b."""
        zero = self.literal(0, dtype)
        if self.folds and b == zero:
            return a
        if self.folds and a == zero:
            return b if sign == "+" else f"(-{b})"
        return f"({a} {sign} {b})"

    def product(self, a: str, b: str, dtype: torch.dtype) -> str:
        """C++ of a * b."""
        zero, one = self.literal(0, dtype), self.literal(1, dtype)
        if self.folds and zero in (a, b):
            return zero
        if self.folds and one in (a, b):
            return b if a == one else a
        return f"({a} * {b})"

    def literal(self, number: float | bool, dtype: torch.dtype) -> str:
        """A constant as a lane vector."""
        return f"splat<{VECTORS[dtype]}>({number_text(number, dtype)})"

    def constant(self, tensor: Tensor) -> Value:
        """A tensor that depends on no input."""
        tensor = tensor.detach()
        dtype = supported(tensor.dtype)
        if tensor.numel() <= REGISTERS:
            numbers = tuple(self.literal(x, dtype) for x in tensor.flatten().tolist())
            return Value(tuple(tensor.shape), dtype, numbers)
        name = self.fresh("k")
        self.shared[name] = tensor.contiguous()
        strides = tuple(tensor.contiguous().stride())
        return Value(tuple(tensor.shape), dtype, array=Array(name, "shared", strides))

    def cast(self, element: str, old: torch.dtype, new: torch.dtype) -> str:
        if old == new:
            return element
        if new == torch.bool:
            return self.emit(new, f"ne({element}, {self.literal(0, old)})")
        return self.emit(new, f"cvt<{VECTORS[new]}>({element})")

    def cast_value(self, value: Value, dtype: torch.dtype) -> Value:
        return value if value.dtype == dtype else self.pointwise([value], dtype, lambda x: x, dtype)

    def names(self, value: Value) -> list[str]:
        """The elements of a small value, loaded from memory where they lie there."""
        if value.array is None:
            return list(value.elements)
        return [self.emit(value.dtype, value.array.at(str(i), value.dtype)) for i in flat_indices(value)]

    def stored(self, value: Value) -> Value:
        """The value in memory."""
        if value.array is not None:
            return value
        result = self.local(value.shape, value.dtype)
        assert result.array is not None
        for i, element in enumerate(value.elements):
            self.lines.append(f"{result.array.pointer}[{i}] = {element};")
        return result

    def local(self, shape: Sequence[int], dtype: torch.dtype) -> Value:
        """A new array, not yet filled."""
        name = self.fresh()
        self.bytes += math.prod(shape) * max(dtype.itemsize, 4)
        self.lines.append(f"{VECTORS[dtype]} {name}[{max(math.prod(shape), 1)}];")
        return Value(tuple(shape), dtype, array=Array(name, "local", contiguous(shape)))

    def pointwise(
        self,
        values: Sequence[Value],
        compute: torch.dtype,
        expression: Callable[..., str],
        dtype: torch.dtype,
        compute_each: Sequence[torch.dtype] | None = None,
        shape: Sequence[int] | None = None,
    ) -> Value:
        """Work out each element from those of the operands, broadcast like tensors.

        Args:
            values: operands.
            compute: type to which the operands are converted first.
            expression: from C++ expressions of the operands' elements to that of the result's.
            dtype: type of the result.
            compute_each: for each operand a type of its own.
            shape: of the result, if more than that of the operands.
        """
        types = compute_each or [compute] * len(values)
        shape = tuple(np.broadcast_shapes(*(v.shape for v in values), *([shape] if shape else [])))
        small = math.prod(shape) <= REGISTERS
        if small:
            columns = [
                [self.cast(e, v.dtype, t) for e in self.names(broadcast(self, v, shape))]
                for v, t in zip(values, types, strict=True)
            ]
            return Value(
                shape, dtype, tuple(self.emit(dtype, expression(*row)) for row in zip(*columns, strict=True))
            )
        arrays = [broadcast(self, self.stored(v), shape) for v in values]
        result = self.local(shape, dtype)
        assert result.array is not None
        loops, index = loops_over(shape)
        operands = []
        for v, t in zip(arrays, types, strict=True):
            assert v.array is not None
            element = v.array.at(position(v.array, index), v.dtype)
            if v.dtype != t and t == torch.bool:
                element = f"ne({element}, {self.literal(0, v.dtype)})"
            elif v.dtype != t:
                element = f"cvt<{VECTORS[t]}>({element})"
            operands.append(element)
        place = position(result.array, index)
        self.lines.append(f"{loops} {result.array.pointer}[{place}] = {expression(*operands)};")
        return result

    def rearrange(self, values: Sequence[Value], function: Callable[..., Tensor]) -> Value:
        """Apply an operation that only picks elements, by doing it to their numbers."""
        dtype = values[0].dtype
        if all(v.array is None or v.size <= REGISTERS for v in values):
            numbers, first = [], 0
            for v in values:
                numbers.append(torch.arange(first, first + v.size).reshape(v.shape))
                first += v.size
            picked = function(*numbers)
            expanded = picked.numel() > REGISTERS and len(values) == 1 and picked._base is not None
            if not expanded:
                elements = [name for v in values for name in self.names(v)]
                chosen = tuple(elements[i] for i in picked.flatten().tolist())
                result = Value(tuple(picked.shape), dtype, chosen)
                return self.stored(result) if len(chosen) > REGISTERS else result
            values = [self.stored(values[0])]  # a view of it, not a statement for every element
        if len(values) > 1:
            raise TraceError("large tensors are joined along more than one dimension")
        (value,) = values
        assert value.array is not None
        reach = sum((n - 1) * s for n, s in zip(value.shape, value.array.strides, strict=True))
        memory = torch.empty(value.array.offset + reach + 1, device="meta")
        empty = memory.as_strided(value.shape, value.array.strides, value.array.offset)
        view = function(empty)
        if view._base is None and view is not empty:
            if value.array.kind != "local" or value.array.strides != contiguous(value.shape):
                value = self.copy(value)
                assert value.array is not None
            empty = torch.empty(value.shape, device="meta")
            view = function(empty)
            if view._base is None and view is not empty:
                raise TraceError("a large tensor is rearranged in a way that is no view")
        array = replace(value.array, strides=tuple(view.stride()), offset=view.storage_offset())
        result = Value(tuple(view.shape), dtype, array=array)
        if result.size <= REGISTERS:
            return Value(result.shape, dtype, tuple(self.names(result)))
        return result

    def gathered(self, value: Value) -> Value:
        """The value in a contiguous array of lane vectors."""
        value = self.stored(value)
        array = value.array
        assert array is not None
        ready = array.kind == "local" and array.offset == 0 and array.strides == contiguous(value.shape)
        return value if ready else self.copy(value)

    def copy(self, value: Value, shape: Sequence[int] | None = None) -> Value:
        """The value in a contiguous array of its own, expanded to a shape."""
        return self.pointwise([value], value.dtype, lambda x: x, value.dtype, shape=shape)

    def finish(self, hoisted: Callable[[torch.dtype], int]) -> tuple[list[str], list[str]]:
        """Statements of the prologue and of the body.

        Args:
            hoisted: reserves a place for a lane vector of the prologue and returns it [bytes per lane].
        """
        late = {name for line in self.lines for name in _NAME.findall(line)}
        stores = []
        for name, (dtype, load) in self._early.items():
            if name in late and load is None:
                place = self._places[name] = f"H + {hoisted(dtype)} * W"
                stores.append(f"st({place}, 0, {name});")
        return self._parameter_loads() + self.prologue + stores, self.loads() + self.lines

    def loads(self) -> list[str]:
        """Statements that stand before the others once the body is finished: what is known before the first step."""
        late = {name for line in self.lines for name in _NAME.findall(line)}
        return [
            f"const {VECTORS[dtype]} {name} = {load or f'ld<{VECTORS[dtype]}>({self._places[name]}, 0)'};"
            for name, (dtype, load) in self._early.items()
            if name in late
        ]

    def _parameter_loads(self) -> list[str]:
        needed = {name for line in self.prologue for name in _NAME.findall(line)}
        return [
            f"const {VECTORS[dtype]} {name} = {load};"
            for name, (dtype, load) in self._early.items()
            if load is not None and name in needed
        ]


def broadcast(body: Body, value: Value, shape: Sequence[int]) -> Value:
    """The value expanded to a shape."""
    if value.shape == tuple(shape):
        return value
    return body.rearrange([value], lambda x: x.expand(tuple(shape)))
