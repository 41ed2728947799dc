"""From traces of torch operations to bytecode: every tensor is an array of rows, one row for each of its elements."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.simulate.bytecode.machine import OPCODES
from deepkoco.graph.execution.fused.trace import Call, Ref, Trace, TraceError

NUMBER = {name: k for k, name in enumerate(OPCODES)}
Node = tuple[
    Any, ...
]  # ("input", name), ("constant", number), or an instruction with the numbers of its sources

MOVES = {
    "view", "_unsafe_view", "reshape", "unsqueeze", "squeeze", "expand", "select", "slice", "unbind", "stack", "cat",
    "permute", "transpose", "t", "clone", "split", "split_with_sizes", "movedim", "alias", "detach", "index_select",
    "select_scatter", "slice_scatter", "flatten", "unflatten", "chunk", "narrow", "diagonal", "flip", "lift_fresh",
}  # fmt: skip
"""Operations that only move elements: done on the numbers of their nodes."""
ONE = {
    "neg": "neg", "abs": "abs", "sqrt": "sqrt", "sin": "sin", "cos": "cos", "tan": "tan", "asin": "asin",
    "acos": "acos", "atan": "atan", "sinh": "sinh", "cosh": "cosh", "tanh": "tanh", "exp": "exp", "expm1": "expm1",
    "log": "log", "log1p": "log1p", "sign": "sign", "sgn": "sign", "floor": "floor", "ceil": "ceil", "erf": "erf",
    "logical_not": "not", "bitwise_not": "not",
}  # fmt: skip
TWO = {
    "mul": "mul", "maximum": "max", "minimum": "min", "atan2": "atan2", "lt": "lt", "le": "le", "gt": "gt", "ge": "ge",
    "eq": "eq", "ne": "ne", "logical_and": "and", "logical_or": "or", "logical_xor": "xor", "bitwise_and": "and",
    "bitwise_or": "or", "bitwise_xor": "xor",
}  # fmt: skip
FLOATS = (torch.float64,)


class Nodes:
    """Values that a program works out, each once."""

    def __init__(self) -> None:
        self.listed: list[Node] = []
        self._known: dict[Node, int] = {}
        self.steady: list[bool] = []  # whether a node follows from parameters and constants alone

    def add(self, node: Node, steady: bool = False) -> int:
        """Return the number of a node; one that is known is not added again."""
        found = self._known.get(node)
        if found is None:
            found = self._known[node] = len(self.listed)
            self.listed.append(node)
            inputs = node[0] in ("input", "constant")
            self.steady.append(steady if inputs else all(self.steady[s] for s in node[1:]))
        return found

    def constant(self, number: float | bool) -> int:
        """Return the node of a number."""
        number = float(number)
        # -0.0 equals 0.0, and not a number does not equal itself.
        return self.add(("constant", number.hex(), number), steady=True)

    def copy(self, node: int) -> int:
        """Return a node of its own that holds the value of another."""
        self.listed.append(("copy", node))
        self.steady.append(False)
        return len(self.listed) - 1

    def of(self, name: str, *sources: int) -> int:
        """Return the node of an instruction."""
        return self.add((name, *sources))


def translated(nodes: Nodes, trace: Trace, inputs: Mapping[str, int]) -> dict[str, int]:
    """Return the nodes of the outputs of a trace.

    Args:
        nodes: They get what the trace adds.
        trace: Of a function of tensors with one element each.
        inputs: Nodes of its inputs.

    Raises:
        TraceError: It has an operation that is no instruction.
    """
    values: dict[int, np.ndarray] = {}
    for name, ref in trace.inputs.items():
        values[id(ref)] = np.full(tuple(ref.example.shape), inputs[name], dtype=np.int64)
    for call in trace.calls:
        _translate(nodes, call, values)
    result = {}
    for name, out in trace.outputs.items():
        found = _array(nodes, out, values)
        if found.size != 1:
            raise TraceError(f"{name} has {found.size} elements for one simulation")
        result[name] = int(found.reshape(-1)[0])
    return result


def _array(nodes: Nodes, value: Any, values: Mapping[int, np.ndarray]) -> np.ndarray:
    """Numbers of the nodes of what an operation reads."""
    if isinstance(value, Ref):
        return values[id(value)]
    if isinstance(value, Tensor):
        flat = [nodes.constant(x) for x in value.detach().double().reshape(-1).tolist()]
        return np.array(flat, dtype=np.int64).reshape(tuple(value.shape))
    if isinstance(value, (int, float, bool)):
        return np.array(nodes.constant(value))
    raise TraceError(f"{type(value).__name__} is no operand")


def _translate(nodes: Nodes, call: Call, values: dict[int, np.ndarray]) -> None:
    name = call.name.removeprefix("aten.").partition(".")[0].removesuffix("_copy")
    if name in MOVES:
        _moved(nodes, call, values)
        return
    if len(call.outputs) != 1:
        raise TraceError(f"{call.name} is no instruction")
    (out,) = call.outputs
    shape, dtype = tuple(out.example.shape), out.example.dtype
    if dtype not in (*FLOATS, torch.bool):
        raise TraceError(f"{call.name} gives {dtype}")
    arguments, options = call.arguments, call.options

    def read(k: int, default: Any = None) -> np.ndarray | None:
        given = arguments[k] if k < len(arguments) else default
        return None if given is None else _array(nodes, given, values)

    def each(function: Callable[..., int], *operands: np.ndarray) -> np.ndarray:
        if all(x.size == 1 for x in operands):  # nearly always, and much faster
            return np.full(shape, function(*(x.item() for x in operands)), dtype=np.int64)
        spread = np.broadcast_arrays(*operands)
        flat = [function(*map(int, items)) for items in zip(*(x.reshape(-1) for x in spread), strict=True)]
        return np.array(flat, dtype=np.int64).reshape(spread[0].shape)

    found = _elementwise(nodes, name, call, read, each)
    if found is None:
        found = _reduced(nodes, name, arguments, options, read)
    if found is None:
        raise TraceError(f"{call.name} is no instruction")
    values[id(out)] = found if found.shape == shape else np.broadcast_to(found, shape)


def _elementwise(nodes: Nodes, name: str, call: Call, read: Any, each: Any) -> np.ndarray | None:
    """Nodes of an operation on elements; None if it is another."""
    of, constant, options, arguments = nodes.of, nodes.constant, call.options, call.arguments
    if name in ONE:
        return each(lambda a: of(ONE[name], a), read(0))
    if name in TWO:
        return each(lambda a, b: of(TWO[name], a, b), read(0), read(1))
    if name in ("add", "sub", "rsub"):
        alpha = options.get("alpha", arguments[2] if len(arguments) > 2 else 1)
        first, second = (read(1), read(0)) if name == "rsub" else (read(0), read(1))
        if alpha != 1:
            second = each(lambda b: of("mul", constant(alpha), b), second)
        return each(lambda a, b: of("add" if name == "add" else "sub", a, b), first, second)
    if name == "div" and options.get("rounding_mode") is None:
        return each(lambda a, b: of("div", a, b), read(0), read(1))
    if name in ("reciprocal", "rsqrt"):
        root = (lambda a: of("sqrt", a)) if name == "rsqrt" else (lambda a: a)
        return each(lambda a: of("div", constant(1.0), root(a)), read(0))
    if name == "square":
        return each(lambda a: of("mul", a, a), read(0))
    if name == "sigmoid":
        return each(
            lambda a: of("div", constant(1.0), of("add", constant(1.0), of("exp", of("neg", a)))), read(0)
        )
    if name == "relu":
        return each(lambda a: of("max", a, constant(0.0)), read(0))
    if name == "pow":
        return each(lambda a, b: _power(nodes, a, b), read(0), read(1))
    if name == "where":
        return each(lambda a, b, c: of("where", a, b, c), read(0), read(1), read(2))
    if name in ("clamp", "clamp_min", "clamp_max", "clip"):
        low, high = (read(1), read(2)) if name in ("clamp", "clip") else (read(1), None)
        if name == "clamp_max":
            low, high = None, low
        found = read(0)
        if low is not None:
            found = each(lambda a, b: of("max", a, b), found, low)
        return found if high is None else each(lambda a, b: of("min", a, b), found, high)
    if name in ("addcmul", "addcdiv"):
        value, inner = options.get("value", 1), "mul" if name == "addcmul" else "div"
        part = each(lambda b, c: of(inner, b, c), read(1), read(2))
        if value != 1:
            part = each(lambda b: of("mul", constant(value), b), part)
        return each(lambda a, b: of("add", a, b), read(0), part)
    if name in ("zeros_like", "ones_like", "full_like", "new_zeros", "new_ones", "new_full"):
        number = (
            arguments[1] if name == "full_like" else arguments[2] if name == "new_full" else "ones" in name
        )
        return np.array(constant(number))
    if name in ("_to", "to"):  # `_to_copy`
        given = call.arguments[0]
        to_truth = call.outputs[0].example.dtype == torch.bool and given.example.dtype != torch.bool
        return each(lambda a: of("ne", a, constant(0.0)), read(0)) if to_truth else read(0)
    return None


def _power(nodes: Nodes, base: int, exponent: int) -> int:
    """A power as torch computes it: squares and cubes by products."""
    node = nodes.listed[exponent]
    number = node[2] if node[0] == "constant" else math.nan
    if number == 2.0:
        return nodes.of("mul", base, base)
    if number == 3.0:
        return nodes.of("mul", nodes.of("mul", base, base), base)
    if number == 0.5:
        return nodes.of("sqrt", base)
    if number == -1.0:
        return nodes.of("div", nodes.constant(1.0), base)
    return nodes.of("pow", base, exponent)


def _reduced(nodes: Nodes, name: str, arguments: Any, options: Any, read: Any) -> np.ndarray | None:
    """Nodes of a sum or of a product of matrices; None if it is another operation."""
    if name in ("sum", "mean"):
        table = read(0)
        dims = arguments[1] if len(arguments) > 1 and arguments[1] is not None else tuple(range(table.ndim))
        dims = tuple(d % max(table.ndim, 1) for d in ((dims,) if isinstance(dims, int) else dims))
        keep = bool(arguments[2]) if len(arguments) > 2 else bool(options.get("keepdim", False))
        kept = [d for d in range(table.ndim) if d not in dims]
        rows = np.moveaxis(table, kept, range(len(kept))).reshape([table.shape[d] for d in kept] + [-1])
        found = _total(nodes, rows)
        if name == "mean":
            count = nodes.constant(rows.shape[-1])
            flat = [nodes.of("div", int(a), count) for a in found.reshape(-1)]
            found = np.array(flat, dtype=np.int64).reshape(found.shape)
        return (
            found.reshape([1 if d in dims else table.shape[d] for d in range(table.ndim)]) if keep else found
        )
    if name in ("mm", "bmm", "mv", "dot"):
        a, b = read(0), read(1)
        if name in ("mv", "dot"):
            b = b[:, None]
        a = a[None] if name == "dot" else a
        products = np.empty((*a.shape[:-1], b.shape[-1], a.shape[-1]), dtype=np.int64)
        for place in np.ndindex(*products.shape):
            *batch, i, j, k = place
            products[place] = nodes.of("mul", int(a[(*batch, i, k)]), int(b[(*batch, k, j)]))
        found = _total(nodes, products)
        return found[..., 0] if name == "mv" else found.reshape(()) if name == "dot" else found
    return None


def _total(nodes: Nodes, rows: np.ndarray) -> np.ndarray:
    """Sums over the last axis."""
    flat = []
    for row in rows.reshape(-1, rows.shape[-1]):
        total = int(row[0])
        for item in row[1:]:
            total = nodes.of("add", total, int(item))
        flat.append(total)
    return np.array(flat, dtype=np.int64).reshape(rows.shape[:-1])


def _moved(nodes: Nodes, call: Call, values: dict[int, np.ndarray]) -> None:
    """Do on the numbers of the nodes what an operation does on the elements."""

    def numbers(value: Any) -> Any:
        if isinstance(value, Ref):
            return torch.from_numpy(np.array(values[id(value)]))
        if isinstance(value, Tensor):
            if not value.dtype.is_floating_point and value.dtype != torch.bool:
                return value  # places of elements
            return torch.from_numpy(_array(nodes, value, values))
        return tuple(numbers(v) for v in value) if isinstance(value, (list, tuple)) else value

    arguments = [numbers(value) for value in call.arguments]
    options = {
        k: v for k, v in call.options.items() if k not in ("dtype", "layout", "device", "memory_format")
    }
    found = call.function(*(list(a) if isinstance(a, tuple) else a for a in arguments), **options)
    pieces = found if isinstance(found, (list, tuple)) else [found]
    for out, piece in zip(call.outputs, pieces, strict=True):
        values[id(out)] = piece.numpy()


def needed_for(nodes: Nodes, wanted: Sequence[int], done: set[int]) -> list[int]:
    """Return all nodes that are worked out for some, in an order in which each follows its sources.

    Args:
        nodes: All nodes.
        wanted: The nodes that are asked for.
        done: Nodes whose values are there.
    """
    needed: list[int] = []
    seen, stack = set(done), [(n, False) for n in reversed(wanted)]
    while stack:
        node, ready = stack.pop()
        if ready:
            needed.append(node)
        elif node not in seen:
            seen.add(node)
            stack.append((node, True))
            stack += [(s, False) for s in nodes.listed[node][1:]]
    return needed


def instructions(
    nodes: Nodes, wanted: Sequence[int], rows: dict[int, int], done: set[int], pool: Rows
) -> np.ndarray:
    """Return (K, 5) instructions that work out some nodes.

    Args:
        nodes: All nodes.
        wanted: Nodes whose rows stay as they are afterwards.
        rows: Node -> its row; wanted nodes are added.
        done: Nodes whose rows hold their values before.
        pool: Where rows come from.
    """
    needed = needed_for(nodes, wanted, done)
    last = {s: k for k, node in enumerate(needed) for s in nodes.listed[node][1:]}
    stays = {*wanted, *done}
    code = []
    for k, node in enumerate(needed):
        name, *sources = nodes.listed[node]
        rows[node] = pool.take()
        places = [rows[s] for s in sources]
        code.append([NUMBER[name], rows[node], *(places + [places[0]] * (3 - len(places)))])
        for source in set(sources):
            if last[source] == k and source not in stays:
                pool.give(rows.pop(source))
    return np.array(code, dtype=np.int64).reshape(-1, 5)


class Rows:
    """Rows of the table; what is given back is taken again."""

    def __init__(self) -> None:
        self.count = 0
        self._free: list[int] = []

    def take(self) -> int:
        """Return a row that nobody uses."""
        if self._free:
            return self._free.pop()
        self.count += 1
        return self.count - 1

    def give(self, row: int) -> None:
        """Give a row back."""
        self._free.append(row)
