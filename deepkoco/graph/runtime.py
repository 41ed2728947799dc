"""The eager runtime: runs the nodes of a batch of environments over their computation graphs."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.computation_graph import ComputationGraph, concatenate
from deepkoco.graph.graph import Graph
from deepkoco.graph.node import Input, State, Supervisor
from deepkoco.graph.schedule import Schedule

NodeParameters = Mapping[str, Mapping[str, Tensor]]
Trace = list[tuple[int, np.ndarray, Tensor]]
"""What ran: node, its step in each environment (-1: none; one number if all the same), outputs (B, ...)."""


class HorizonError(RuntimeError):
    """An environment has taken all supervisor steps that its timing was drawn for."""


@dataclass(frozen=True)
class RuntimeState:
    """Everything that a batch of environments remembers between two actions; never changed in place.

    Attributes:
        schedule: when what runs, shared by the environments.
        row: (B,) int64, schedule row of each environment.
        step: (B,) int64, supervisor step that waits for its action.
        parameters: by node name and parameter name, scalars or (B, ...).
        nodes: by node name, its state, (B, ...) each.
        outputs: by node name, its last outputs, (B, ...) each: that of step k is outputs[k % len(outputs)].
        readings: what the supervisor's `observe` returned last, (B, ...) by name.
    """

    schedule: Schedule
    row: np.ndarray
    step: np.ndarray
    parameters: dict[str, dict[str, Tensor]]
    nodes: dict[str, State]
    outputs: dict[str, tuple[Tensor, ...]]
    readings: dict[str, Tensor]

    @property
    def steps_left(self) -> np.ndarray:
        """Number of actions that each environment can still take, (B,)."""
        return self.schedule.timing.steps - self.step

    @property
    def time(self) -> np.ndarray:
        """Start of the supervisor step that waits for its action [s], (B,) float64."""
        timing = self.schedule.timing
        base = timing.layout.step_base[timing.layout.supervisor]
        return timing.t_start[self.row, base + self.step] / timing.resolution


class BatchedRuntime:
    """Executes a graph for a batch of environments, each with delays of its own.

    It owns nothing that changes: `reset` and `step` take and return states. Node functions run once per
    slot for the whole batch; where only some environments have that step, the others keep what they had.

    Args:
        graph: the nodes and connections.
        timing: the computation graph that `reset` uses unless it is given another.
        device: where the tensors live.
    """

    def __init__(
        self, graph: Graph, timing: ComputationGraph | None = None, device: torch.device | str = "cpu"
    ) -> None:
        self.graph = graph
        self.device = torch.device(device)
        self._schedule = None if timing is None else Schedule(timing, self.device)
        self._edges = [
            [(e, c) for e, c in enumerate(graph.connections) if c.receiver == node.name]
            for node in graph.nodes
        ]

    def reset(
        self,
        parameters: NodeParameters,
        generator: torch.Generator,
        initial: Mapping[str, State] | None = None,
        *,
        timing: ComputationGraph | None = None,
        rows: np.ndarray | None = None,
        state: RuntimeState | None = None,
        mask: np.ndarray | Tensor | None = None,
        trace: Trace | None = None,
    ) -> tuple[RuntimeState, dict[str, Input]]:
        """Start episodes and run them up to the supervisor's first step.

        Args:
            parameters: by node name; a node that is not named has none. Scalars or (B, ...).
            generator: passed to each node's `init`.
            initial: by node name, states or parts of states (B, ...) that replace those of `init`.
            timing: fresh schedules for the whole batch; of a part of the batch, the rows of the
                environments in `mask` are used. None: those of the constructor.
            rows: (B,) schedule that each environment runs, of those there are; None: `row` of the timing.
            state: a running batch, of which only the environments in `mask` start anew.
            mask: (B,) bool, which environments of `state` start anew; None: all.
            trace: takes note of every step that runs.

        Returns:
            The state and what the supervisor sees, by name of its input.

        Raises:
            ValueError: no timing was given, or names and shapes do not fit.
        """
        schedule = self._schedule if timing is None else Schedule(timing, self.device)
        if schedule is None:
            raise ValueError("no timing: give one to the runtime or to reset")
        rows = schedule.timing.row if rows is None else np.asarray(rows, dtype=np.int64)
        fresh = self._start(schedule, rows, parameters, generator, initial or {})
        fresh = self._run(fresh, trace)
        supervisor = self.graph.supervisor
        fresh, inputs = self._observe(fresh, fresh.outputs[supervisor][0])
        if state is not None and mask is not None:
            fresh = self._merge(state, fresh, np.asarray(mask, dtype=np.bool_))
            inputs = self._inputs(fresh, self.graph.index[supervisor], fresh.step)
        return fresh, inputs

    def step(
        self, state: RuntimeState, action: Tensor, trace: Trace | None = None
    ) -> tuple[RuntimeState, dict[str, Input]]:
        """Give the supervisor's output and run everything up to its next step.

        Args:
            state: what `reset` or `step` returned.
            action: (B, M) output of the supervisor step that waits.
            trace: takes note of every step that runs, that of the supervisor included.

        Returns:
            The next state and what the supervisor sees then.

        Raises:
            HorizonError: the timing of an environment ends here.
        """
        spent = np.flatnonzero(state.steps_left <= 0)
        if len(spent):
            raise HorizonError(
                f"environment {spent[0]} has taken all {state.schedule.timing.steps} supervisor steps of its "
                "timing; draw a longer one or reset it"
            )
        outputs = dict(state.outputs)
        outputs[self.graph.supervisor] = _write(outputs[self.graph.supervisor], action, state.step)
        if trace is not None:
            trace.append((self.graph.index[self.graph.supervisor], state.step, action))
        state = self._run(replace(state, step=state.step + 1, outputs=outputs), trace)
        return self._observe(state, action)

    def _observe(self, state: RuntimeState, action: Tensor) -> tuple[RuntimeState, dict[str, Input]]:
        """Let the supervisor see its inputs at the step that waits for an action."""
        name = self.graph.supervisor
        inputs = self._inputs(state, self.graph.index[name], state.step)
        supervisor = self.graph.node(name)
        if not isinstance(supervisor, Supervisor):
            return state, inputs
        own, readings = supervisor.observe(state.parameters[name], state.nodes[name], inputs, action)
        return replace(state, nodes=state.nodes | {name: own}, readings=readings), inputs

    def _start(
        self,
        schedule: Schedule,
        row: np.ndarray,
        parameters: NodeParameters,
        generator: torch.Generator,
        initial: Mapping[str, State],
    ) -> RuntimeState:
        batch, known = len(row), len(schedule.t_start)
        if batch and not (row.min() >= 0 and row.max() < known):
            raise ValueError(f"rows {row.min()} to {row.max()}: there are schedules 0 to {known - 1}")
        for name in (*parameters, *initial):
            if name not in self.graph.index:
                raise ValueError(f'"{name}" is no node; known: {", ".join(self.graph.index)}')
        nodes, outputs, values = {}, {}, {}
        for position, node in enumerate(self.graph.nodes):
            values[node.name] = dict(parameters.get(node.name, {}))
            node_state = dict(node.init(values[node.name], generator, batch))
            for key, value in initial.get(node.name, {}).items():
                if key not in node_state or value.shape != node_state[key].shape:
                    there = {k: tuple(v.shape) for k, v in node_state.items()}
                    raise ValueError(f'initial "{node.name}.{key}" {tuple(value.shape)} does not fit {there}')
                node_state[key] = value
            nodes[node.name] = node_state
            output = node.initial_output(values[node.name], node_state, batch)
            outputs[node.name] = (output,) * int(schedule.depth[position])
        step = np.zeros(batch, dtype=np.int64)
        return RuntimeState(schedule, row, step, values, nodes, outputs, {})

    def _run(self, state: RuntimeState, trace: Trace | None) -> RuntimeState:
        """Run the slots before the supervisor step that each environment is at."""
        nodes, outputs = dict(state.nodes), dict(state.outputs)
        state = replace(state, nodes=nodes, outputs=outputs)
        row, step = state.row, state.step
        if (row == row[0]).all() and (step == step[0]).all():
            row, step = row[:1], step[:1]  # one order for all: look it up once
        table = state.schedule.table[row, step]
        for slot, position in enumerate(state.schedule.slots.tolist()):
            seq = table[:, slot]
            runs = seq >= 0
            if not runs.any():
                continue
            node = self.graph.nodes[position]
            # What the others would see is never used: let them look where those that run do.
            inputs = self._inputs(state, position, seq if runs.all() else np.where(runs, seq, seq.max()))
            node_state, output = node.step(state.parameters[node.name], nodes[node.name], inputs)
            if not runs.all():
                mask = torch.from_numpy(runs).to(self.device)
                old = nodes[node.name]
                node_state = {key: _where(mask, value, old[key]) for key, value in node_state.items()}
            nodes[node.name] = node_state
            outputs[node.name] = _write(outputs[node.name], output, seq)
            if trace is not None:
                trace.append((position, seq, output))
        return state

    def _inputs(self, state: RuntimeState, position: int, step: np.ndarray) -> dict[str, Input]:
        """Collect what a node sees at its step `step`, (B,) or (1,) if it is the same for all."""
        schedule, batch = state.schedule, len(state.row)
        layout = schedule.timing.layout
        # Where all are at the same step, what they see lies side by side in the tables: slice, else gather.
        together = schedule.direct(state.row) and bool((step == step[0]).all())
        rows, places = state.row[:, None], np.broadcast_to(step, batch)[:, None]

        def pick(table: Any, base: int, size: int) -> Any:
            if together:
                first = base + int(step[0]) * size
                return table[:, first : first + size]
            columns = base + places * size + np.arange(size)
            return (
                table[rows, columns]
                if isinstance(table, np.ndarray)
                else table[_index(rows), _index(columns)]
            )

        def spread(chosen: Tensor) -> Tensor:
            return chosen.expand(batch, chosen.shape[1]) if len(chosen) < batch else chosen

        t_start = spread(pick(schedule.t_start, int(layout.step_base[position]), 1))[:, 0]
        inputs = {}
        for edge, connection in self._edges[position]:
            where = int(layout.window_base[edge]), connection.window
            inputs[connection.name] = Input(
                data=_read(state.outputs[connection.sender], pick(schedule.timing.windows, *where)),
                seq=spread(pick(schedule.seq, *where)),
                t_sent=spread(pick(schedule.t_sent, *where)),
                t_received=spread(pick(schedule.t_received, *where)),
                t_start=t_start,
            )
        return inputs

    def _merge(self, running: RuntimeState, fresh: RuntimeState, mask: np.ndarray) -> RuntimeState:
        """Take the environments in `mask` from `fresh`, the others from `running`."""
        if fresh.schedule is running.schedule:
            schedule, row = fresh.schedule, np.where(mask, fresh.row, running.row)
        else:
            kept, new = np.flatnonzero(~mask), np.flatnonzero(mask)
            parts = [
                replace(running.schedule.timing, row=running.row).take(kept),
                fresh.schedule.timing.take(new),
            ]
            timing = concatenate(self.graph, [part for part in parts if part.batch])
            row = np.empty(len(mask), dtype=np.int64)
            row[np.concatenate([kept, new])] = timing.row
            schedule = Schedule(replace(timing, row=row), self.device)
        where = torch.from_numpy(mask).to(self.device)
        outputs = {}
        for position, node in enumerate(self.graph.nodes):
            depth = int(schedule.depth[position])
            old = _resize(running.outputs[node.name], depth, _written(running, position))
            new = _resize(fresh.outputs[node.name], depth, _written(fresh, position))
            outputs[node.name] = tuple(_where(where, n, o) for n, o in zip(new, old, strict=True))
        return RuntimeState(
            schedule=schedule,
            row=row,
            step=np.where(mask, fresh.step, running.step),
            parameters={
                name: {
                    key: _where(where, value, running.parameters[name][key]) for key, value in values.items()
                }
                for name, values in fresh.parameters.items()
            },
            nodes={
                name: {key: _where(where, value, running.nodes[name][key]) for key, value in values.items()}
                for name, values in fresh.nodes.items()
            },
            outputs=outputs,
            readings={
                key: _where(where, value, running.readings[key]) for key, value in fresh.readings.items()
            },
        )


def _index(places: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(places, dtype=np.int64))


def _where(mask: Tensor, new: Tensor, old: Tensor) -> Tensor:
    if new is old or (new.ndim == old.ndim == 0 and torch.equal(new, old)):
        return new
    dimensions = max(new.ndim, old.ndim, 1)
    return torch.where(mask.reshape(-1, *(1,) * (dimensions - 1)), new, old)


def _write(cells: tuple[Tensor, ...], output: Tensor, seq: np.ndarray) -> tuple[Tensor, ...]:
    """Put outputs of steps `seq` into their cells; (B,), or (1,) if the same for all; -1 writes nothing."""
    depth = len(cells)
    written = list(cells)
    cell = np.where(seq >= 0, seq % depth, -1)
    if (cell == cell[0]).all():
        written[cell[0]] = output
        return tuple(written)
    for place in np.unique(cell[cell >= 0]).tolist():
        mask = torch.from_numpy(cell == place).to(output.device)
        written[place] = _where(mask, output, cells[place])
    return tuple(written)


def _read(cells: tuple[Tensor, ...], seq: np.ndarray) -> Tensor:
    """Gather the outputs of steps `seq`, (B, window) or (1, window) if the same for all."""
    place = seq % len(cells)
    if len(place) == 1 or (place == place[0]).all():
        chosen = [cells[i] for i in place[0].tolist()]
        return chosen[0].unsqueeze(1) if len(chosen) == 1 else torch.stack(chosen, dim=1)
    device = cells[0].device
    everything = torch.stack(cells, dim=1)
    environment = torch.arange(len(place), device=device)[:, None]
    return everything[environment, torch.from_numpy(place).to(device)]


def _written(state: RuntimeState, position: int) -> np.ndarray:
    """Number of outputs that a node has sent in each environment, (B,)."""
    return state.schedule.timing.boundary[state.row, state.step, position].astype(np.int64)


def _resize(cells: tuple[Tensor, ...], depth: int, written: np.ndarray) -> tuple[Tensor, ...]:
    """Move the last outputs into `depth` cells, so that step k is again in cell k % depth."""
    if len(cells) == depth:
        return cells
    cell = np.arange(depth)
    # The latest step that belongs into each cell; what has left the old cells is not needed any more.
    seq = written[:, None] - 1 - (written[:, None] - 1 - cell) % depth
    return _read(cells, seq).unbind(dim=1)
