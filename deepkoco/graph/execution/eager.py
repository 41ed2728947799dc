"""The eager executor: runs node functions slot by slot as torch operations on the whole batch."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution import cells
from deepkoco.graph.execution.executor import take_steps
from deepkoco.graph.execution.initial import EpisodeSetup, initial_state
from deepkoco.graph.execution.policy import Policy, as_function, given_actions, signals_at
from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.execution.state import HorizonError, RuntimeState, Trace
from deepkoco.graph.model.calls import call_observe, call_step
from deepkoco.graph.model.contract import check_action, check_output, check_state, located
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Input, Supervisor
from deepkoco.graph.supergraph import join_slots
from deepkoco.graph.timing.computation_graph import concatenate


class EagerExecutor:
    """Runs any node on any device, with gradients; the reference for the compiled executors.

    Node functions run once per slot for the whole batch; where only some environments have that step, the
    others keep what they had.

    Args:
        graph: the nodes and connections.
        device: where the tensors live.
    """

    name = "eager"

    def __init__(self, graph: Graph, device: torch.device) -> None:
        self.graph, self.device = graph, device
        self._edges = [
            [(e, c) for e, c in enumerate(graph.connections) if c.receiver == node.name]
            for node in graph.nodes
        ]

    def start(self, setup: EpisodeSetup) -> RuntimeState:
        return initial_state(self.graph, setup)

    def adopt(self, state: RuntimeState) -> RuntimeState:
        return state.unpacked()

    def begin(self, state: RuntimeState, trace: Trace | None = None) -> RuntimeState:
        """Run up to the supervisor's first step."""
        state = self._run(state, trace)
        return self._observe(state, state.outputs[self.graph.supervisor][0])

    def step(
        self, state: RuntimeState, action: Tensor | np.ndarray, trace: Trace | None = None
    ) -> RuntimeState:
        """Give the supervisor's output and run everything up to its next step."""
        action = torch.as_tensor(action, device=self.device)
        HorizonError.check(state, 1)
        supervisor = self.graph.supervisor
        check_action(supervisor, int(state.step[0]), action, state.outputs[supervisor][0])
        outputs = state.outputs | {supervisor: cells.write(state.outputs[supervisor], action, state.step)}
        if trace is not None:
            trace.append((self.graph.index[supervisor], state.step, action))
        return self._observe(self._run(replace(state, step=state.step + 1, outputs=outputs), trace), action)

    def rollout(
        self,
        state: RuntimeState,
        policy: Policy,
        steps: int,
        parameters: Mapping[str, Tensor] | None,
        signals: Mapping[str, Tensor],
        record: tuple[str, ...],
    ) -> tuple[RuntimeState, dict[str, Tensor]]:
        """Take steps with a policy's actions; see `BatchedRuntime.rollout`."""
        HorizonError.check(state, steps)
        if isinstance(policy, Tensor):
            shape = tuple(state.outputs[self.graph.supervisor][0].shape[1:])
            given = given_actions(policy, state, steps, shape)

            def decide(state: RuntimeState, k: int) -> Tensor:
                return given[k].expand(state.batch, *shape)
        else:
            function, values = as_function(policy, parameters)

            def decide(state: RuntimeState, k: int) -> Tensor:
                seen = state.readings or self.inputs(state)
                return function(values, {**seen, **signals_at(signals, k, state.batch)})

        return take_steps(self, state, decide, steps, record)

    def inputs(self, state: RuntimeState) -> dict[str, Input]:
        """What the supervisor sees at the step that waits for an action."""
        return self._inputs(state, self.graph.index[self.graph.supervisor], state.step)

    def _observe(self, state: RuntimeState, action: Tensor) -> RuntimeState:
        name = self.graph.supervisor
        supervisor = self.graph.node(name)
        if not isinstance(supervisor, Supervisor) or type(supervisor).observe is Supervisor.observe:
            return state
        seen = self.inputs(state)
        try:
            own, readings = call_observe(supervisor, state.parameters[name], state.nodes[name], seen, action)
        except Exception as error:
            raise located(name, state.step, error) from error
        return replace(state, nodes=state.nodes | {name: own}, readings=readings)

    def _run(self, state: RuntimeState, trace: Trace | None) -> RuntimeState:
        """Run the slots before the supervisor step that each environment is at."""
        nodes, outputs = dict(state.nodes), dict(state.outputs)
        state = replace(state, nodes=nodes, outputs=outputs)
        row, step = state.row, state.step
        if (row == row[0]).all() and (step == step[0]).all():
            row, step = row[:1], step[:1]  # one order for all: look it up once
        table: Any = state.schedule.table[row, step].astype(np.int64)
        running = table >= 0
        some, every = running.any(axis=0).tolist(), running.all(axis=0).tolist()
        for slot, position in enumerate(state.schedule.slots.tolist()):
            if not some[slot]:
                continue
            seq, runs = table[:, slot], running[:, slot]
            node = self.graph.nodes[position]
            # What the others would see is never used: let them look where those that run do.
            inputs = self._inputs(state, position, seq if every[slot] else np.where(runs, seq, seq.max()))
            old = nodes[node.name]
            try:
                node_state, output = call_step(node, state.parameters[node.name], old, inputs)
                check_state(node_state, old)
                check_output(output, outputs[node.name][0])
            except Exception as error:
                raise located(node.name, seq[runs], error) from error
            if not every[slot]:
                mask = torch.from_numpy(np.ascontiguousarray(runs)).to(self.device)
                node_state = {key: cells.where(mask, value, old[key]) for key, value in node_state.items()}
            nodes[node.name] = node_state
            outputs[node.name] = cells.write(outputs[node.name], output, seq)
            if trace is not None:
                trace.append((position, seq, output))
        return state

    def _inputs(self, state: RuntimeState, position: int, step: np.ndarray) -> dict[str, Input]:
        """Collect what a node sees at its step `step`, (B,) or (1,) if it is the same for all."""
        schedule, batch = state.schedule, state.batch
        layout = schedule.timing.layout
        # Where all are at the same step, what they see lies side by side in the tables: slice, else gather.
        level = len(step) == 1 or bool((step == step[0]).all())
        together = level and schedule.direct(state.row)
        rows, places = state.row[:, None], step[:, None]
        if not together and level:
            places = places[:1]
            if bool((state.row == state.row[0]).all()):
                rows = rows[:1]

        def pick(base: int, size: int, *tables: Any) -> list[Any]:
            if together:
                first = base + int(step[0]) * size
                return [table[:, first : first + size] for table in tables]
            # One flat index for all tables: a pair of indices costs three times as much.
            flat = rows * tables[0].shape[1] + (base + places * size)
            if size > 1:
                flat = flat + np.arange(size)
            index = _index(flat, self.device)
            return [
                table.reshape(-1).take(flat) if isinstance(table, np.ndarray) else table.take(index)
                for table in tables
            ]

        def spread(chosen: Tensor) -> Tensor:
            return chosen.expand(batch, chosen.shape[1]) if len(chosen) < batch else chosen

        (starts,) = pick(int(layout.step_base[position]), 1, schedule.t_start)
        t_start = spread(starts)[:, 0]
        inputs = {}
        for edge, connection in self._edges[position]:
            seen, *times = pick(
                int(layout.window_base[edge]),
                connection.window,
                schedule.timing.windows,
                schedule.seq,
                schedule.t_sent,
                schedule.t_received,
            )
            data = cells.read(state.outputs[connection.sender], seen)
            inputs[connection.name] = Input(
                connection.seen(data), *(spread(t) for t in times), t_start=t_start
            )
        return inputs

    def merge(self, running: RuntimeState, fresh: RuntimeState, mask: np.ndarray) -> RuntimeState:
        """Take the environments in `mask` from `fresh`, the others from `running`."""
        if fresh.schedule is running.schedule:
            schedule, row = fresh.schedule, np.where(mask, fresh.row, running.row)
        else:
            kept, new = np.flatnonzero(~mask), np.flatnonzero(mask)
            parts = [
                replace(running.schedule.timing, row=running.row).take(kept),
                replace(fresh.schedule.timing, row=fresh.row).take(new),
            ]
            timing = concatenate(self.graph, [part for part in parts if part.batch])
            row = np.empty(len(mask), dtype=np.int64)
            row[np.concatenate([kept, new])] = timing.row
            merged = join_slots(
                running.schedule.merged.take(np.unique(running.row[kept])),
                fresh.schedule.merged.take(np.unique(fresh.row[new])),
            )
            schedule = Schedule(replace(timing, row=row), self.device, merged)
        where = torch.from_numpy(mask).to(self.device)
        outputs = {}
        for position, node in enumerate(self.graph.nodes):
            old, new = (
                cells.resize(
                    part.outputs[node.name],
                    int(schedule.depth[position]),
                    part.schedule.executed[part.row, part.step, position].astype(np.int64),
                )
                for part in (running, fresh)
            )
            outputs[node.name] = tuple(cells.where(where, n, o) for n, o in zip(new, old, strict=True))
        return RuntimeState(
            schedule=schedule,
            row=row,
            step=np.where(mask, fresh.step, running.step),
            parameters=_merged(where, running.parameters, fresh.parameters),
            nodes=_merged(where, running.nodes, fresh.nodes),
            outputs=outputs,
            readings=_merged(where, {"": running.readings}, {"": fresh.readings})[""],
        )


def _merged(mask: Tensor, running: Any, fresh: Any) -> dict[str, dict[str, Tensor]]:
    return {
        name: {key: cells.where(mask, value, running[name][key]) for key, value in values.items()}
        for name, values in fresh.items()
    }


def _index(places: np.ndarray, device: torch.device) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(places, dtype=np.int64)).to(device)
