"""Rollouts inside a kernel, with a compiled policy or given actions."""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.fused.compiler import load
from deepkoco.graph.execution.fused.kernel import Binding, Kernel, RolloutCall
from deepkoco.graph.execution.fused.lowered import check_stack
from deepkoco.graph.execution.fused.memory import address
from deepkoco.graph.execution.fused.policy_source import policy_source
from deepkoco.graph.execution.fused.program import input_examples, make_inputs, part, traced
from deepkoco.graph.execution.fused.record import Field, lay_out
from deepkoco.graph.execution.fused.source import MOST_IN_FLIGHT
from deepkoco.graph.execution.fused.state import FusedState
from deepkoco.graph.execution.policy import PolicyFunction
from deepkoco.graph.execution.state import HorizonError


class CompiledPolicy:
    """A policy's function as machine code.

    Args:
        kernel: of the graph that it acts in.
        function: pure, see `BatchedRuntime.rollout`.
        parameters: examples; later ones must have the same shapes.
        signals: examples (steps, B or 1, ...), likewise.

    Raises:
        TraceError: the function cannot be compiled.
    """

    def __init__(
        self,
        kernel: Kernel,
        function: PolicyFunction,
        parameters: Mapping[str, Tensor],
        signals: Mapping[str, Tensor],
    ) -> None:
        graph = kernel.graph
        edges = graph.inputs_of(graph.supervisor)
        specs = {n.name: program.output for n, program in zip(graph.nodes, kernel.programs, strict=True)}
        sent = {name: torch.zeros(1, *shape, dtype=dtype) for name, (dtype, shape) in specs.items()}
        readings = kernel.source.readings
        examples = {f"p.{key}": value.detach().cpu().clone() for key, value in parameters.items()}
        examples |= {
            f"r.{k}": torch.zeros(1, *field.shape, dtype=field.dtype) for k, field in readings.items()
        }
        examples |= input_examples(edges, sent)
        self.signals, self.signal_bytes = lay_out(
            {name: (value.dtype, tuple(value.shape[2:])) for name, value in signals.items()}
        )
        check_stack(MOST_IN_FLIGHT * kernel.lanes * self.signal_bytes)
        examples |= {
            f"g.{name}": torch.zeros(1, *field.shape, dtype=field.dtype)
            for name, field in self.signals.items()
        }

        def run(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
            seen = part(tensors, "r.") if readings else make_inputs(edges, tensors)
            return {"action": function(part(tensors, "p."), {**seen, **part(tensors, "g.")})}

        trace = traced("policy", run, examples)
        action = specs[graph.supervisor]
        self.source = policy_source(graph, trace, readings, self.signals, action, kernel.lanes)
        self._weights, self._views = self.source.pool(parameters)
        self._library = load(self.source.text)
        names = ["policy", "policies"][: 1 + self.source.side_by_side]
        pointers = [ctypes.cast(getattr(self._library, name), ctypes.c_void_p).value for name in names]
        self.address, self.side_by_side = pointers if len(pointers) > 1 else (*pointers, None)
        self.looks = any(name == "t_start" or name.startswith("i.") for name in self.source.uses)

    @torch.no_grad()
    def pack(self, parameters: Mapping[str, Tensor]) -> np.ndarray:
        """The parameters as the kernel reads them, until the next call."""
        for name, view in self._views.items():
            view.copy_(parameters[name])
        return self._weights


def run_rollout(
    state: FusedState,
    steps: int,
    record: tuple[str, ...],
    threads: int,
    *,
    policy: CompiledPolicy | None = None,
    weights: np.ndarray | None = None,
    signals: Mapping[str, Tensor] | None = None,
    actions: Tensor | None = None,
) -> tuple[FusedState, dict[str, Tensor]]:
    """Take steps with a policy or with given actions; nothing is done if an environment has too few left."""
    binding = state.binding
    moving = binding.allocate()
    given = BlockCall(binding, steps, [name for name in record if name != "action"], actions)
    taken = dict(given.taken)
    call = given.struct
    if "action" in record:
        taken["action"] = torch.empty(steps, *binding.action_shape, dtype=binding.action_type)
        call.out_actions = taken["action"].data_ptr()
    if policy is not None:
        assert weights is not None
        call.policy, call.policies, call.weights = policy.address, policy.side_by_side, address(weights)
        call.looks = policy.looks
        given.show(policy.signals, policy.signal_bytes, signals or {})
    spent = over_blocks(
        binding,
        threads,
        lambda first, last, _: binding.kernel.rollout(
            binding.model, state.fixed.address, state.moving.address, moving.address, given.part(first, last)
        ),
    )
    if spent >= 0:
        raise HorizonError.of(spent, state.schedule, int(state.steps_left[spent]), steps)
    return state.after(moving), {name: taken[name] for name in record}


class BlockCall:
    """What a kernel is told of a rollout, and where it writes the readings.

    Args:
        binding: the kernel and its tables.
        steps: number of actions.
        readings: names of those to record.
        actions: (steps, B or 1, M), where they are given.

    Attributes:
        struct: as the kernel reads it.
        taken: (steps, B, ...) by name.
    """

    def __init__(self, binding: Binding, steps: int, readings: Sequence[str], actions: Tensor | None) -> None:
        source = binding.kernel.source
        fields = [source.readings[name] for name in readings]
        self.taken = {
            name: torch.empty(steps, binding.batch, *field.shape, dtype=field.dtype)
            for name, field in zip(readings, fields, strict=True)
        }
        columns = [
            np.array([getattr(field, name) for field in fields], dtype=np.int64)
            for name in ("offset", "count", "size")
        ]
        targets = np.array([value.data_ptr() for value in self.taken.values()], dtype=np.int64)
        self.struct = call = RolloutCall(steps=steps, first=0, last=binding.blocks, outputs=len(fields))
        call.reading_offset, call.reading_count, call.reading_size, call.out_readings = (
            address(array) for array in (*columns, targets)
        )
        if actions is not None:
            actions = actions.detach().to("cpu", binding.action_type).contiguous()
            size = actions[0, 0].numel() * actions.element_size()
            call.actions, call.action_time = actions.data_ptr(), size * actions.shape[1]
            call.action_environment = size if actions.shape[1] > 1 else 0
        self._kept: list[Any] = [columns, targets, actions]

    def show(self, fields: Mapping[str, Field], size: int, signals: Mapping[str, Tensor]) -> None:
        """Have a policy see signals (steps, B or 1, ...), which have these places in a record of this size."""
        values = [signals[name].detach().to("cpu").contiguous() for name in fields]
        own = [field.count * field.size for field in fields.values()]
        columns = {
            "offset": [field.offset for field in fields.values()],
            "count": [field.count for field in fields.values()],
            "size": [field.size for field in fields.values()],
            "time": [bytes_ * value.shape[1] for bytes_, value in zip(own, values, strict=True)],
            "environment": [
                bytes_ if value.shape[1] > 1 else 0 for bytes_, value in zip(own, values, strict=True)
            ],
            "from": [value.data_ptr() for value in values],
        }
        arrays = {name: np.array(column, dtype=np.int64) for name, column in columns.items()}
        for name, array in arrays.items():
            setattr(self.struct, f"signal_{name}", address(array))
        self.struct.signals, self.struct.signal_bytes = len(fields), size
        self._kept += [values, arrays]

    def part(self, first: int, last: int) -> int:
        """Address of the same call for some of the blocks; it lives as long as this object."""
        own = RolloutCall.from_buffer_copy(self.struct)
        own.first, own.last = first, last
        self._kept.append(own)
        return ctypes.addressof(own)


def over_blocks(binding: Binding, threads: int, run: Callable[[int, int, int], int]) -> int:
    """Run blocks first to last in each of some threads; return the first environment that is short of steps, or -1.

    Args:
        binding: says how many blocks there are.
        threads: how many.
        run: from the first block, the one behind the last and the number of the thread to such an environment.
    """
    if threads == 1 or binding.blocks == 1:
        return run(0, binding.blocks, 0)
    bounds = np.linspace(0, binding.blocks, min(threads, binding.blocks) + 1).astype(int).tolist()
    with ThreadPoolExecutor(len(bounds) - 1) as pool:
        found = list(pool.map(run, bounds[:-1], bounds[1:], range(len(bounds) - 1)))
    return min((environment for environment in found if environment >= 0), default=-1)
