"""Programs: the functions of a graph's nodes traced on one environment."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from deepkoco.graph.execution.fused.record import NUMPY, Spec
from deepkoco.graph.execution.fused.trace import Ref, Trace, TraceError, trace
from deepkoco.graph.model.calls import call_observe, call_step
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Input, Node, Supervisor

TIMES = ("seq", "t_sent", "t_received")


@dataclass(frozen=True)
class Program:
    """A node's function and what it remembers.

    Attributes:
        trace: inputs are named "p.<parameter>", "s.<state>", "i.<input>.<field>", "t_start" and, of
            `observe`, "action"; outputs "s.<state>" and "output", or "r.<reading>". None: does nothing.
        parameters, state: by name, type and shape of one environment.
        constant: states that the function hands on unchanged.
        output: what the node sends.
        readings: what `observe` reads.
    """

    trace: Trace | None
    parameters: dict[str, Spec]
    state: dict[str, Spec]
    constant: frozenset[str]
    output: Spec
    readings: dict[str, Spec]


def spec(tensor: Tensor) -> Spec:
    """Type and shape of one environment's part of a (B, ...) tensor, or of a scalar for all."""
    return tensor.dtype, tuple(tensor.shape[1:])


def one(tensor: Tensor) -> Tensor:
    """The first environment's part of a (B, ...) tensor, with a batch of one; a scalar is itself."""
    return (tensor if tensor.ndim == 0 else tensor[:1]).detach().clone()


def trace_graph(
    graph: Graph,
    parameters: Mapping[str, Mapping[str, Tensor]],
    states: Mapping[str, Mapping[str, Tensor]],
    outputs: Mapping[str, Tensor],
    gradients: bool = False,
) -> list[Program]:
    """Trace every node of a graph.

    Args:
        graph: nodes and connections.
        parameters, states, outputs: by node name, what `reset` starts with, (B, ...).
        gradients: trace what the functions do where gradients are wanted.

    Raises:
        TraceError: names the node and the operation that cannot be compiled.
    """
    sent = {name: one(output) for name, output in outputs.items()}
    for _ in range(4):
        programs = [
            _program(graph, node, parameters[node.name], states[node.name], sent, gradients)
            for node in graph.nodes
        ]
        types = {n.name: p.output[0] for n, p in zip(graph.nodes, programs, strict=True)}
        if all(sent[name].dtype == dtype for name, dtype in types.items()):
            return programs
        sent = {name: value.to(types[name]) for name, value in sent.items()}
    raise TraceError("the types of the outputs depend on each other without end")


def _program(
    graph: Graph,
    node: Node,
    parameters: Mapping[str, Tensor],
    state: Mapping[str, Tensor],
    sent: Mapping[str, Tensor],
    gradients: bool,
) -> Program:
    edges = graph.inputs_of(node.name)
    for key, value in (*parameters.items(), *state.items(), ("output", sent[node.name])):
        if value.dtype not in NUMPY:
            raise TraceError(f'node "{node.name}": "{key}" of type {value.dtype} is not compiled')
    own = {key: one(value) for key, value in state.items()}
    examples = {f"p.{key}": one(value) for key, value in parameters.items()}
    examples |= {f"s.{key}": value for key, value in own.items()}
    examples |= input_examples(edges, sent)
    observes = isinstance(node, Supervisor)
    if observes:
        if type(node).observe is Supervisor.observe:
            return Program(
                None, {}, {k: spec(v) for k, v in own.items()}, frozenset(own), spec(sent[node.name]), {}
            )
        examples["action"] = sent[node.name]

    def function(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
        values = part(tensors, "p.")
        before, inputs = part(tensors, "s."), make_inputs(edges, tensors)
        if isinstance(node, Supervisor):
            after, readings = call_observe(node, values, before, inputs, tensors["action"])
            results = {f"r.{key}": value for key, value in readings.items()}
        else:
            after, output = call_step(node, values, before, inputs)
            results = {"output": output}
        return {f"s.{key}": value for key, value in after.items()} | results

    found = traced(f'node "{node.name}"', function, examples, gradients)
    after = {name: _example(value) for name, value in found.outputs.items()}
    for key, value in own.items():
        new = after.get(f"s.{key}")
        if new is None or new.dtype != value.dtype or new.shape != value.shape:
            became = "nothing" if new is None else f"{new.dtype} {tuple(new.shape)}"
            raise TraceError(
                f'node "{node.name}": state "{key}" {value.dtype} {tuple(value.shape)} becomes {became}'
            )
    output = sent[node.name] if observes else after["output"]
    if output.shape != sent[node.name].shape:
        raise TraceError(
            f'node "{node.name}": initial output {tuple(sent[node.name].shape)}, output {tuple(output.shape)}'
        )
    return Program(
        trace=found,
        parameters={key: spec(value) for key, value in parameters.items()},
        state={key: spec(value) for key, value in own.items()},
        constant=frozenset(key for key in own if found.outputs[f"s.{key}"] is found.inputs[f"s.{key}"]),
        output=spec(output),
        readings={name[2:]: spec(value) for name, value in after.items() if name.startswith("r.")},
    )


def traced(
    who: str,
    function: Callable[[dict[str, Tensor]], dict[str, Tensor]],
    examples: dict[str, Tensor],
    gradients: bool = False,
) -> Trace:
    """Trace a function, as it runs where gradients are wanted or not; say whose it was if that fails."""
    try:
        return trace(differentiated(function) if gradients else function, examples, gradients)
    except TraceError as error:
        raise TraceError(f"{who}: {error}") from None
    except Exception as error:
        # Its own mistake, which it makes in the eager executor too, or one of the tracing, which it does not.
        raise TraceError(f"{who}: {type(error).__name__}: {error}") from error


def differentiated(
    function: Callable[[dict[str, Tensor]], dict[str, Tensor]],
) -> Callable[[dict[str, Tensor]], dict[str, Tensor]]:
    """The function as it runs while gradients are wanted with respect to every number that it is given."""

    def run(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
        numbers = {name: value for name, value in tensors.items() if value.is_floating_point()}
        # Its results are handed through beside a dummy: they may be integers, which have no gradient.
        found: Any = torch.func.vjp(
            lambda own: (torch.zeros(()), function(tensors | own)), numbers, has_aux=True
        )
        return found[2]

    return run


def input_examples(edges: tuple[Connection, ...], sent: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Examples of everything that a node sees, by the names of a trace."""
    examples = {"t_start": torch.zeros(1, dtype=torch.float64)}
    for edge in edges:
        data = sent[edge.sender].unsqueeze(1)
        examples[f"i.{edge.name}.data"] = data.repeat_interleave(edge.window, dim=1)
        examples[f"i.{edge.name}.seq"] = torch.zeros(1, edge.window, dtype=torch.int64)
        for name in ("t_sent", "t_received"):
            examples[f"i.{edge.name}.{name}"] = torch.zeros(1, edge.window, dtype=torch.float64)
    return examples


def make_inputs(edges: tuple[Connection, ...], tensors: Mapping[str, Tensor]) -> dict[str, Input]:
    """What a node sees, from the tensors of a trace."""
    return {
        str(edge.name): Input(
            edge.seen(tensors[f"i.{edge.name}.data"]),
            *(tensors[f"i.{edge.name}.{name}"] for name in TIMES),
            t_start=tensors["t_start"],
        )
        for edge in edges
    }


def part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose names begin with a prefix, without it."""
    return {name[len(prefix) :]: value for name, value in tensors.items() if name.startswith(prefix)}


def _example(value: Ref | Tensor | Any) -> Tensor:
    return value.example if isinstance(value, Ref) else value
