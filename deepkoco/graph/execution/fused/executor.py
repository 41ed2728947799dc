"""The fused executor: a graph's node functions compiled into one kernel over blocks of environments."""

import warnings
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution import cells
from deepkoco.graph.execution.eager import EagerExecutor
from deepkoco.graph.execution.executor import NoDerivativeError, NotCompiledError, take_steps
from deepkoco.graph.execution.fused.adjoint.kernel import AdjointKernel
from deepkoco.graph.execution.fused.adjoint.leaves import leaves_of, wants_gradients
from deepkoco.graph.execution.fused.adjoint.rollout import differentiable_rollout
from deepkoco.graph.execution.fused.adjoint.source import adjoint_source
from deepkoco.graph.execution.fused.kernel import Binding, Kernel
from deepkoco.graph.execution.fused.memory import address
from deepkoco.graph.execution.fused.program import trace_graph
from deepkoco.graph.execution.fused.record import NUMBER, Field, Records
from deepkoco.graph.execution.fused.rollout import CompiledPolicy, run_rollout
from deepkoco.graph.execution.fused.source import kernel_source
from deepkoco.graph.execution.fused.state import FusedState, Place
from deepkoco.graph.execution.initial import EpisodeSetup
from deepkoco.graph.execution.inputs import LazyInputs
from deepkoco.graph.execution.policy import Policy, PolicyFunction, as_function, given_actions, signals_at
from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.execution.state import HorizonError, RuntimeState, Trace
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Input

FEW = 4  # up to this many environments, one lane each is faster than blocks that are mostly empty

POLICIES = 16
"""Policies whose machine code is kept: a program that makes a function for every rollout has no end of them."""


class FusedExecutor:
    """Runs compiled kernels.

    What node functions take from anywhere but their arguments is fixed when a kernel is made, at the first
    reset with parameters and states of the same shapes.

    Args:
        graph: the nodes and connections.
        device: must be the CPU.
        threads: number of threads that share the blocks of a rollout.
    """

    name = "fused"

    def __init__(self, graph: Graph, device: torch.device, threads: int = 1) -> None:
        if device.type != "cpu":
            raise ValueError(f'executor "fused" runs on the CPU, not on {device}')
        self.graph, self.threads = graph, threads
        self.eager = EagerExecutor(graph, device)
        self._kernels: dict[Any, Kernel] = {}
        self._refused: dict[Any, str] = {}
        self._bindings: dict[Any, Binding] = {}
        self._policies: OrderedDict[Any, CompiledPolicy | None] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        # Machine code and addresses belong to this process: a copy makes its own.
        return self.__dict__ | {
            "_kernels": {},
            "_refused": {},
            "_bindings": {},
            "_policies": OrderedDict(),
        }

    def start(self, setup: EpisodeSetup) -> RuntimeState:
        return self.eager.start(setup)

    def begin(self, state: RuntimeState, trace: Trace | None = None) -> FusedState:
        if trace is not None:
            return self.adopt(self.eager.begin(state, trace))
        if wants_gradients(state):
            return differentiable_rollout(self._with_leaves(state, fresh=True), 0, (), self.threads)[0]
        kernel = self._kernel(state)
        packed = self._pack(kernel, state)
        kernel.start(packed.binding.model, packed.fixed.address, packed.moving.address)
        return packed

    def adopt(self, state: RuntimeState) -> FusedState:
        if isinstance(state, FusedState):
            return state
        if wants_gradients(state):
            return self._with_leaves(state)
        return self._pack(self._kernel(state), state)

    def _with_leaves(self, state: RuntimeState, fresh: bool = False) -> FusedState:
        """The state on a kernel with a way back, with its numbers as tensors."""
        if not isinstance(state, FusedState):
            kernel = self._kernel(state, gradients=True)
            packed = self._pack(kernel, state)
            return packed.after(packed.moving, leaves_of(kernel, state, fresh))
        if state.leaves is not None:
            return state
        if state.twin is None:
            state.__dict__["twin"] = self._with_leaves(state.unpacked())
        assert state.twin is not None
        return state.twin

    def _without_leaves(self, state: FusedState) -> FusedState:
        """The state on the forward kernel: one with a way back does what nodes do where gradients are wanted."""
        if not isinstance(state.binding.kernel, AdjointKernel):
            return state
        if state.twin is None:
            plain = state.unpacked()
            state.__dict__["twin"] = self._pack(self._kernel(plain), plain)
        assert state.twin is not None
        return state.twin

    def step(self, state: FusedState, action: Tensor | np.ndarray, trace: Trace | None = None) -> FusedState:
        if trace is not None:
            after = self.eager.step(state.unpacked(), torch.as_tensor(action), trace)
            return self.adopt(after)
        state = state.current()
        if wants_gradients(state, action if isinstance(action, Tensor) else None):
            action = torch.as_tensor(action)
            state.binding.action(action)
            start = self._with_leaves(state)
            return differentiable_rollout(start, 1, (), self.threads, actions=action[None])[0]
        state = self._without_leaves(state)
        binding = state.binding
        action = binding.action(action)
        moving = binding.allocate()
        spent = binding.kernel.step(
            binding.model, state.fixed.address, state.moving.address, moving.address, address(action)
        )
        if spent >= 0:
            raise HorizonError.of(spent, state.schedule)
        return state.after(moving)

    def rollout(
        self,
        state: FusedState,
        policy: Policy,
        steps: int,
        parameters: Mapping[str, Tensor] | None,
        signals: Mapping[str, Tensor],
        record: tuple[str, ...],
    ) -> tuple[FusedState, dict[str, Tensor]]:
        """Take steps inside the kernel; see `BatchedRuntime.rollout`."""
        state = state.current()
        if isinstance(policy, Tensor):
            shape = state.binding.action_shape[1:]
            given = given_actions(policy, state, steps, shape)
            if wants_gradients(state, given):
                start = self._with_leaves(state)
                return differentiable_rollout(start, steps, record, self.threads, actions=given)
            return run_rollout(self._without_leaves(state), steps, record, self.threads, actions=given)
        function, values = as_function(policy, parameters)
        if wants_gradients(state, *values.values(), *signals.values()):
            return self._steps(self._with_leaves(state), function, values, signals, steps, record)
        state = self._without_leaves(state)
        compiled = self._policy(state, function, values, signals)
        if compiled is not None:
            weights = compiled.pack(values)
            return run_rollout(
                state, steps, record, self.threads, policy=compiled, weights=weights, signals=signals
            )
        with torch.no_grad():
            return self._steps(state, function, values, signals, steps, record)

    def _steps(
        self,
        state: FusedState,
        function: PolicyFunction,
        values: Mapping[str, Tensor],
        signals: Mapping[str, Tensor],
        steps: int,
        record: tuple[str, ...],
    ) -> tuple[FusedState, dict[str, Tensor]]:
        """Call a policy between the steps."""
        HorizonError.check(state, steps)

        def decide(state: FusedState, k: int) -> Tensor:
            seen = state.readings or self.inputs(state)
            return function(values, {**seen, **signals_at(signals, k, state.batch)})

        return take_steps(self, state, decide, steps, record)

    def _policy(
        self,
        state: FusedState,
        function: PolicyFunction,
        parameters: Mapping[str, Tensor],
        signals: Mapping[str, Tensor],
    ) -> CompiledPolicy | None:
        """The policy's machine code; None if it cannot be compiled, which is said once."""
        kernel = state.binding.kernel
        shapes = tuple((name, value.dtype, value.shape[2:]) for name, value in signals.items())
        key = id(kernel), function, tuple((k, v.dtype, v.shape) for k, v in parameters.items()), shapes
        if key not in self._policies:
            try:
                self._policies[key] = CompiledPolicy(kernel, function, parameters, signals)
            except NotCompiledError as error:
                warnings.warn(f"{error}; this policy runs between steps", RuntimeWarning, stacklevel=4)
                self._policies[key] = None
            if len(self._policies) > POLICIES:
                self._policies.popitem(last=False)
        self._policies.move_to_end(key)
        policy = self._policies[key]
        if policy is not None:
            state.binding.see(policy.source.uses)
        return policy

    def inputs(self, state: FusedState) -> Mapping[str, Input]:
        return LazyInputs(state.binding.input_names, lambda: self.eager.inputs(state.unpacked()))

    def merge(self, running: FusedState, fresh: FusedState, mask: np.ndarray) -> FusedState:
        leaves = running.leaves is not None or fresh.leaves is not None
        if leaves or running.binding is not fresh.binding:
            merged = self.eager.merge(running.unpacked(), fresh.unpacked(), mask)
            return self.adopt(merged)
        return self._merge_records(running.current(), fresh, mask)

    def _kernel(self, state: RuntimeState, gradients: bool = False) -> Kernel:
        """The graph's machine code for states of this shape, with the way back if gradients are wanted.

        Raises:
            NotCompiledError: the graph cannot be compiled.
            NoDerivativeError: it can, but not its derivative.
        """
        lanes = 1 if state.batch <= FEW else 0
        parts = {**state.parameters, **{f"{n} state": s for n, s in state.nodes.items()}}
        parts["outputs"] = {name: own[0] for name, own in state.outputs.items()}
        signature = (
            lanes,
            gradients,
            *(
                (name, key, value.dtype, value.ndim > 0 and value.shape[1:], value.ndim)
                for name, values in parts.items()
                for key, value in values.items()
            ),
        )
        if signature in self._refused:
            raise NoDerivativeError(self._refused[signature])
        if signature not in self._kernels:
            try:
                self._kernels[signature] = self._compile(state, lanes, gradients)
            except NotCompiledError as error:
                if not gradients:
                    raise
                self._kernel(state)
                self._refused[signature] = str(error)
                raise NoDerivativeError(str(error)) from error
        return self._kernels[signature]

    def _compile(self, state: RuntimeState, lanes: int, gradients: bool) -> Kernel:
        outputs = {n: own[0] for n, own in state.outputs.items()}
        programs = trace_graph(self.graph, state.parameters, state.nodes, outputs, gradients)
        double = any(program.output[0] == torch.float64 for program in programs)
        write, kind = (adjoint_source, AdjointKernel) if gradients else (kernel_source, Kernel)
        source = write(self.graph, programs, lanes or (8 if double else 16))
        return kind(self.graph, programs, source)

    def _bind(self, kernel: Kernel, schedule: Schedule, batch: int) -> Binding:
        key = id(kernel), id(schedule), batch
        found = self._bindings.get(key)
        if found is None or found.schedule is not schedule:
            # One schedule at a time is in use, all but always, with gradients or without.
            for old, binding in list(self._bindings.items()):
                if binding.schedule is not schedule or binding.batch != batch:
                    del self._bindings[old]
            found = self._bindings[key] = Binding(kernel, schedule, batch)
        return found

    def _pack(self, kernel: Kernel, state: RuntimeState, place: Place | None = None) -> FusedState:
        """Put an eager state into records."""
        binding = self._bind(kernel, state.schedule, state.batch)
        source, lanes = kernel.source, kernel.lanes
        place = place or Place(state.row, lanes)
        packed = FusedState(
            binding, place, state.row, state.parameters, binding.allocate(fixed=True), binding.allocate()
        )
        fixed, moving = packed.records
        fixed.view(NUMBER)[...] = place.environment.reshape(binding.blocks, 1, lanes)
        fixed.view(replace(NUMBER, offset=4))[...] = state.row[place.source].reshape(binding.blocks, 1, lanes)
        moving.view(NUMBER)[...] = state.step[place.source].reshape(binding.blocks, 1, lanes)
        for (name, key), field in source.parameters.items():
            fixed.pack(field, state.parameters[name][key], place.source)
        for (name, key), field in source.fixed.items():
            fixed.pack(field, state.nodes[name][key], place.source)
        for (name, key), field in source.moving.items():
            moving.pack(field, state.nodes[name][key], place.source)
        for name, field in binding.readings.items():
            if name in state.readings:
                moving.pack(field, state.readings[name], place.source)
        for position, node in enumerate(self.graph.nodes):
            ring = binding.rings[node.name]
            own = state.outputs[node.name]
            if any(cell is not own[0] for cell in own):
                written = state.schedule.executed[state.row, state.step, position].astype(np.int64)
                own = cells.resize(own, ring.cells, written)
            for cell in range(ring.cells):
                dtype, shape = kernel.programs[position].output
                field = Field(dtype, shape, 0)
                at = Field(dtype, shape, ring.offset + cell * field.count * field.size)
                moving.pack(at, own[cell % len(own)], place.source)
        return packed

    def _merge_records(self, running: FusedState, fresh: FusedState, mask: np.ndarray) -> FusedState:
        """Take lanes from one state or the other, in the order of the running one."""
        binding, lanes = running.binding, running.binding.kernel.lanes
        place = running.place
        others = fresh.records
        if not np.array_equal(place.environment, fresh.place.environment):
            order = fresh.place.lane_of[place.source]
            others = tuple(
                _reorder(other, order, binding.fields(fixed))
                for other, fixed in zip(others, (True, False), strict=True)
            )
        taken = mask[place.source].reshape(binding.blocks, 1, lanes)
        merged = binding.allocate(fixed=True), binding.allocate()
        for k, (target, old, new) in enumerate(zip(merged, running.records, others, strict=True)):
            result = Records(target.rows(binding.blocks), lanes)
            result.buffer[...] = old.buffer
            for field, copies in binding.fields(fixed=k == 0):
                np.copyto(result.view(field, copies), new.view(field, copies), where=taken)
        chosen = torch.from_numpy(mask)
        parameters = {
            name: {k: cells.where(chosen, v, running.parameters[name][k]) for k, v in values.items()}
            for name, values in fresh.parameters.items()
        }
        row = np.where(mask, fresh.row, running.row)
        return FusedState(binding, place, row, parameters, *merged)


def _reorder(records: Records, order: np.ndarray, fields: list[tuple[Field, int]]) -> Records:
    """Records whose lane l is the old lane order[l]; environments keep their numbers."""
    result = Records(np.zeros_like(records.buffer), records.lanes)
    blocks = len(records.buffer)
    for field, copies in fields:
        flat = records.view(field, copies).transpose(0, 2, 1).reshape(len(order), -1)
        result.view(field, copies)[...] = flat[order].reshape(blocks, records.lanes, -1).transpose(0, 2, 1)
    return result
