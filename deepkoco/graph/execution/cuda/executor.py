"""The CUDA executor: supervisor steps captured as CUDA graphs.

A CUDA graph rather than a compiler: it is captured in well under a second, runs the very kernels that the
eager executor runs, so that the results on one device are the same, and takes every operation of torch. What it
saves is the launch of each kernel from Python.

All but `capture.py` is also tested on the CPU, where the same function runs operation by operation on the same fixed
tensors.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.cuda.binding import Binding, constants
from deepkoco.graph.execution.cuda.names import named_carry, named_parameters
from deepkoco.graph.execution.cuda.packing import Buffers, Packing, clone, specs_of
from deepkoco.graph.execution.cuda.recent import Recent
from deepkoco.graph.execution.cuda.state import DeviceState
from deepkoco.graph.execution.cuda.supervisor_step import Carry, SupervisorStep, Uses
from deepkoco.graph.execution.eager import EagerExecutor
from deepkoco.graph.execution.initial import EpisodeSetup
from deepkoco.graph.execution.inputs import LazyInputs
from deepkoco.graph.execution.policy import Policy, as_function, given_actions
from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.execution.state import HorizonError, RuntimeState, Trace
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Input

SCHEDULES, BINDINGS = 2, 4  # kept for use again; each binding holds a batch of environments


class TensorExecutor:
    """Runs supervisor steps as one function of tensors, captured on a CUDA device; no gradients.

    Nodes are initialised on the device of the generator that is passed to `reset`, so that a seed gives the same
    draws as in the other executors, and then brought to the device. What node functions take from
    anywhere but their arguments is fixed when a step is captured.

    Args:
        graph: the nodes and connections.
        device: where the tensors live.
        capture: whether steps are captured as CUDA graphs; without, any device will do.
    """

    name = "cuda"

    def __init__(self, graph: Graph, device: torch.device, *, capture: bool) -> None:
        self.graph, self.device, self.capture = graph, device, capture
        self._eager = EagerExecutor(graph, device)
        self._uses: dict[str, Uses] = {}
        self._functions: Recent[Any, SupervisorStep] = Recent(SCHEDULES)
        self._bindings: Recent[Any, Binding] = Recent(BINDINGS)

    def __getstate__(self) -> dict[str, Any]:
        # What is captured belongs to this process and device: a copy makes its own.
        return self.__dict__ | {"_uses": {}, "_functions": Recent(SCHEDULES), "_bindings": Recent(BINDINGS)}

    def start(self, setup: EpisodeSetup) -> RuntimeState:
        generator = setup.generator
        device = (generator if isinstance(generator, torch.Generator) else generator[0]).device
        parameters, initial = _placed(setup.parameters, device), _placed(setup.initial, device)
        return self._eager.start(replace(setup, parameters=parameters, initial=initial))

    @torch.no_grad()
    def begin(self, state: RuntimeState, trace: Trace | None = None) -> DeviceState:
        """Bring a state to the device and run up to the supervisor's first step."""
        state = self._on_device(state)
        if trace is not None:
            with constants(self.device):
                return self._packed(self._eager.begin(state, trace))
        with constants(self.device):
            carry = self._function(state.schedule).begin(state.parameters, self._carry(state))
        return self._state(state, carry)

    @torch.no_grad()
    def step(
        self, state: DeviceState, action: Tensor | np.ndarray, trace: Trace | None = None
    ) -> DeviceState:
        """Give the supervisor's output and run everything up to its next step."""
        binding, action = state.binding, torch.as_tensor(action)
        if action.shape != binding.action.shape:
            raise ValueError(f"action {tuple(action.shape)} where {tuple(binding.action.shape)} is expected")
        if trace is not None:
            with constants(self.device):
                placed = action.to(self.device, binding.action.dtype)
                return self._packed(self._eager.step(state.unpacked(), placed, trace))
        HorizonError.check(state, 1)
        binding.load(state.fixed, state.moving)
        work = binding.stepper()
        binding.action.copy_(action)
        work()
        return state.after(1, binding.unload())

    @torch.no_grad()
    def rollout(
        self,
        state: DeviceState,
        policy: Policy,
        steps: int,
        parameters: Mapping[str, Tensor] | None,
        signals: Mapping[str, Tensor],
        record: tuple[str, ...],
    ) -> tuple[DeviceState, dict[str, Tensor]]:
        """Take steps without a word from the host but the start of each; see `BatchedRuntime.rollout`."""
        HorizonError.check(state, steps)
        binding, given = state.binding, None
        shown: Mapping[str, Tensor] = {}
        binding.load(state.fixed, state.moving)
        if isinstance(policy, Tensor):
            given = given_actions(policy, state, steps, tuple(binding.action.shape[1:])).to(self.device)
            work = binding.stepper()
        else:
            work, shown = binding.policy_stepper(*as_function(policy, parameters), signals)
        source = {**binding.readings, "action": binding.action}
        taken = {
            name: torch.empty(steps, *source[name].shape, dtype=source[name].dtype, device=self.device)
            for name in record
        }
        for k in range(steps):
            if given is not None:
                binding.action.copy_(given[k])
            for name, place in shown.items():
                place.copy_(signals[name][k])
            work()
            for name, values in taken.items():
                values[k].copy_(source[name])
        return state.after(steps, binding.unload()), taken

    def inputs(self, state: DeviceState) -> Mapping[str, Input]:
        """What the supervisor sees, gathered when it is looked at."""
        names = tuple(str(connection.name) for connection in self.graph.inputs_of(self.graph.supervisor))
        return LazyInputs(names, lambda: state.binding.function.inputs(state.carry))

    @torch.no_grad()
    def merge(self, running: DeviceState, fresh: DeviceState, mask: np.ndarray) -> DeviceState:
        """Take the environments in `mask` from `fresh`, the others from `running`."""
        if running.binding is not fresh.binding or not _same_for_all(running, fresh):
            return self._packed(self._eager.merge(running.unpacked(), fresh.unpacked(), mask))
        where = torch.from_numpy(mask).to(self.device)
        buffers = clone(fresh.fixed), clone(fresh.moving)
        for target, other in zip(_batched(fresh, *buffers), _batched(running), strict=True):
            chosen = where.reshape(-1, *(1,) * (target.ndim - 1))
            target.copy_(torch.where(chosen, target, other))
        row, step = np.where(mask, fresh.row, running.row), np.where(mask, fresh.step, running.step)
        return DeviceState(fresh.binding, row, step, *buffers)

    @torch.no_grad()
    def adopt(self, state: RuntimeState) -> DeviceState:
        """The state in buffers on the device."""
        return state if isinstance(state, DeviceState) else self._packed(self._on_device(state.unpacked()))

    def _on_device(self, state: RuntimeState) -> RuntimeState:
        return replace(
            state,
            parameters=_placed(state.parameters, self.device),
            nodes=_placed(state.nodes, self.device),
            outputs={n: tuple(v.to(self.device) for v in own) for n, own in state.outputs.items()},
            readings={name: value.to(self.device) for name, value in state.readings.items()},
        )

    def _function(self, schedule: Schedule) -> SupervisorStep:
        def make() -> SupervisorStep:
            return SupervisorStep(self.graph, schedule, self.device, self._uses)

        return self._functions.get(schedule, make)

    def _carry(self, state: RuntimeState) -> Carry:
        """A state of the eager executor on the device, in rings."""
        rings = {}
        for name, own in state.outputs.items():
            cells = own if len(own) == 1 else (*own, own[0])  # one more for those that write nothing
            rings[name] = torch.stack(cells)
        return Carry(
            torch.from_numpy(np.ascontiguousarray(state.row)).to(self.device),
            torch.from_numpy(state.step).to(self.device),
            dict(state.nodes),
            rings,
            dict(state.readings),
        )

    def _packed(self, state: RuntimeState) -> DeviceState:
        return self._state(state, self._carry(state))

    def _state(self, state: RuntimeState, carry: Carry) -> DeviceState:
        """A state with the schedule and parameters of one and the tensors of the other."""
        tensors, parameters = named_carry(carry), named_parameters(state.parameters)
        moving, fixed = specs_of(tensors), specs_of(parameters)

        def make() -> Binding:
            return Binding(
                self._function(state.schedule), Packing(fixed), Packing(moving), capture=self.capture
            )

        key = state.schedule, tuple(fixed.items()), tuple(moving.items())
        binding = self._bindings.get(key, make)
        return DeviceState(
            binding,
            state.row,
            state.step,
            binding.fixed.pack(parameters, self.device),
            binding.moving.pack(tensors, self.device),
        )


def cuda_executor(graph: Graph, device: torch.device) -> TensorExecutor:
    """The executor on a CUDA device.

    Raises:
        ValueError: another device was asked for, or there is none.
    """
    if device.type != "cuda":
        raise ValueError(f'executor "cuda" runs on a CUDA device, not on {device}')
    if not torch.cuda.is_available():
        raise ValueError(
            f'executor "cuda": torch {torch.__version__} finds no CUDA device; install a torch build with CUDA on '
            'a machine with an NVIDIA GPU and its driver, or choose executor="fused" on the CPU'
        )
    index = torch.cuda.current_device() if device.index is None else device.index
    return TensorExecutor(graph, torch.device("cuda", index), capture=True)


def _placed(values: Any, device: torch.device) -> dict[str, dict[str, Tensor]]:
    return {name: {key: v.detach().to(device) for key, v in own.items()} for name, own in values.items()}


def _parts(state: DeviceState, fixed: Buffers, moving: Buffers) -> tuple[list[Tensor], list[Tensor]]:
    """Tensors with the batch first, and those that are the same for all environments."""
    binding, each, common = state.binding, [], []
    named = [*binding.fixed.views(fixed).values()]
    for place, view in binding.moving.views(moving).items():
        named.append(view.transpose(0, 1) if place[0] == "ring" else view)
    for view in named:
        (each if view.ndim and len(view) == state.batch else common).append(view)
    return each, common


def _batched(state: DeviceState, fixed: Buffers | None = None, moving: Buffers | None = None) -> list[Tensor]:
    return _parts(state, fixed or state.fixed, moving or state.moving)[0]


def _same_for_all(one: DeviceState, other: DeviceState) -> bool:
    """Whether what all environments share is the same in two states."""
    pairs = zip(*(_parts(state, state.fixed, state.moving)[1] for state in (one, other)), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)
