"""Flat names of the tensors of a state, under which they are packed into buffers."""

from collections.abc import Mapping

from torch import Tensor

from deepkoco.graph.execution.cuda.packing import Name
from deepkoco.graph.execution.cuda.supervisor_step import Carry

Names = Mapping[str, Mapping[str, Tensor]]


def named_parameters(parameters: Names) -> dict[Name, Tensor]:
    """Parameters by flat names."""
    return {(name, key): value for name, own in parameters.items() for key, value in own.items()}


def parameters_of(tensors: Mapping[Name, Tensor], nodes: tuple[str, ...]) -> dict[str, dict[str, Tensor]]:
    """Parameters by node."""
    result: dict[str, dict[str, Tensor]] = {name: {} for name in nodes}
    for (name, key), value in tensors.items():
        result[name][key] = value
    return result


def named_carry(carry: Carry) -> dict[Name, Tensor]:
    """Everything of a carry by flat names."""
    named: dict[Name, Tensor] = {("row",): carry.row, ("step",): carry.step}
    named |= {("node", name, key): v for name, own in carry.nodes.items() for key, v in own.items()}
    named |= {("ring", name): ring for name, ring in carry.rings.items()}
    return named | {("reading", name): value for name, value in carry.readings.items()}


def carry_of(tensors: Mapping[Name, Tensor], nodes: tuple[str, ...]) -> Carry:
    """A carry from its flat names."""
    carry = Carry(tensors[("row",)], tensors[("step",)], {name: {} for name in nodes}, {}, {})
    for place, tensor in tensors.items():
        match place:
            case ("node", name, key):
                carry.nodes[name][key] = tensor
            case ("ring", name):
                carry.rings[name] = tensor
            case ("reading", name):
                carry.readings[name] = tensor
    return carry
