"""The C++ text of a policy, and how its parameters are packed."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.fused.body import Body
from deepkoco.graph.execution.fused.lowered import (
    MOST_STACK,
    check_stack,
    header_text,
    load_tensor,
    lower_trace,
    pool_lines,
    seen_messages,
    store_tensor,
)
from deepkoco.graph.execution.fused.mixed import SIDE_BY_SIDE, mixed_policy
from deepkoco.graph.execution.fused.pool import Pool
from deepkoco.graph.execution.fused.record import Field, Spec
from deepkoco.graph.execution.fused.trace import Trace, TraceError
from deepkoco.graph.execution.fused.value import SCALARS, Array, Value, contiguous
from deepkoco.graph.model.graph import Graph


@dataclass(frozen=True)
class PolicySource:
    """A policy's function and how its parameters are packed.

    Attributes:
        text: C++.
        order: parameters in the order of the pool, and whether each is packed transposed.
        constants: large constants, packed behind the parameters.
        uses: names of the trace's inputs that it reads.
        side_by_side: whether there is a function for several blocks at once.
    """

    text: str
    order: tuple[tuple[str, bool], ...]
    constants: np.ndarray
    uses: set[str]
    side_by_side: bool

    def pool(self, parameters: Mapping[str, Tensor]) -> tuple[np.ndarray, dict[str, Tensor]]:
        """The parameters as the kernel reads them, and views by name into which later ones are copied."""
        pool, starts = Pool(), {}
        for name, transposed in self.order:
            value = parameters[name].detach().to("cpu")
            starts[name] = pool.add((value.t() if transposed else value).contiguous())
        weights, views = np.concatenate([pool.join(), self.constants]), {}
        for name, transposed in self.order:
            value = parameters[name]
            size = value.numel() * value.element_size()
            flat = torch.from_numpy(weights[starts[name] : starts[name] + size]).view(value.dtype)
            views[name] = flat.view(value.t().shape).t() if transposed else flat.view(value.shape)
        return weights, views


def policy_source(
    graph: Graph,
    trace: Trace,
    readings: Mapping[str, Field],
    signals: Mapping[str, Field],
    action: Spec,
    lanes: int,
) -> PolicySource:
    """Write a policy: parameters are shared by all environments.

    Args:
        trace: inputs "p.<parameter>", "r.<reading>", "g.<signal>" and those of the supervisor; output "action".
        readings, signals: where their records have them.
    """
    body, pool = Body("policy"), Pool()
    uses = trace.used()
    order, inputs, heads = [], {}, []
    for name, ref in trace.inputs.items():
        if not name.startswith("p."):
            continue
        turned = ref.example.ndim == 2 and any(
            call.name.split(".")[1] in ("t", "transpose", "permute") and ref in call.arguments
            for call in trace.calls
        )
        order.append((name[2:], turned))
        start = pool.add((ref.example.t() if turned else ref.example).contiguous())
        dtype, shape = ref.example.dtype, tuple(ref.example.shape)
        pointer = body.fresh("k")
        heads.append(f"const {SCALARS[dtype]} *{pointer} = (const {SCALARS[dtype]} *)(weights + {start});")
        strides = (1, shape[0]) if turned else contiguous(shape)
        inputs[name] = Value(shape, dtype, array=Array(pointer, "shared", strides))
    inputs |= seen_messages(body, graph, graph.supervisor, trace, uses)
    for record, prefix, fields in (("R", "r", readings), ("G", "g", signals)):
        for key, place in fields.items():
            if (name := f"{prefix}.{key}") in uses:
                inputs[name] = load_tensor(body, f"{record} + {place.offset} * W", trace.inputs[name])
    (output,) = lower_trace(body, "policy", trace, inputs).values()
    if (output.dtype, output.shape[1:]) != action:
        output = body.cast_value(output, action[0])
        if output.shape[1:] != action[1]:
            raise TraceError(f"policy: an action is {action[1]}, not {output.shape[1:]}")
    store_tensor(body, "Y", output)
    check_stack(lanes * body.bytes)
    early, lines = body.finish(lambda _: 0)
    assert not early, "a policy has no parameters of single environments"
    behind = Pool(size=pool.size)
    heads += pool_lines(body, behind, "weights")
    # Those that see the inputs are asked block by block: each has messages of its own.
    side_by_side = lanes > 1 and not any(name == "t_start" or name.startswith("i.") for name in uses)
    side_by_side = side_by_side and SIDE_BY_SIDE * lanes * body.bytes <= MOST_STACK
    mixed = mixed_policy(lines, SIDE_BY_SIDE) if side_by_side else None
    copies = range(SIDE_BY_SIDE)
    together = [
        'extern "C" void policies(const char *weights, const char *const *R, const char *const *G, char *const *Y) {',
        *(f"  const char *const {name}_{k} = {name}[{k}];" for name in "RG" for k in copies),
        *(f"  char *const Y_{k} = Y[{k}];" for k in copies),
        *(f"  Far far_{k};" for k in copies),
        *(f"  {line}" for line in heads),
        *(mixed or []),
        "}",
    ]
    text = "\n".join(
        [
            f"#define W {lanes}",
            header_text("lanes.h"),
            header_text("functions.h"),
            f"static const int PLACES = {max(1, sum(c.window for c in graph.inputs_of(graph.supervisor)))};",
            'extern "C" void policy(const char *weights, const char *R, const char *const *X, const VL *Q, '
            "const VD *T, const char *G, char *Y) {",
            *(f"  {line}" for line in ["Far far;", *heads, *lines]),
            "}",
            *(together if mixed is not None else []),
            "",
        ]
    )
    return PolicySource(text, tuple(order), behind.join(), uses, mixed is not None)
