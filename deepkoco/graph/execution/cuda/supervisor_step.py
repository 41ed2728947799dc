"""The supervisor step: all slots between two actions as one function of tensors.

It has static shapes, reads no value on the host and changes none of its arguments, so that it can be captured
as a CUDA graph; on the CPU it runs as it is. Every slot runs for the whole batch, and masks keep what the
environments had in which it has nothing to do.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.utils._pytree import tree_leaves

from deepkoco.graph.execution.cuda.modes import Watching
from deepkoco.graph.execution.cuda.rings import Cells, merged
from deepkoco.graph.execution.cuda.tables import PassTables, Read
from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.model.calls import call_observe, call_step
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Input, State, Supervisor

TIMES = ("seq", "t_sent", "t_received", "t_start")
Uses = frozenset[tuple[str, str]]
"""Which fields of which inputs a function reads, beyond the data."""


@dataclass
class Carry:
    """What goes from one supervisor step to the next, all on the device.

    Attributes:
        row, step: (B,) int64, schedule and waiting supervisor step of each environment.
        nodes: by node name, its state, (B, ...) each.
        rings: by node name, its last outputs (cells, B, ...): that of step k is in cell k % depth. A ring of
            more than one cell has one more, where environments write in which nothing runs.
        readings: of the supervisor, (B, ...) by name.
    """

    row: Tensor
    step: Tensor
    nodes: dict[str, State]
    rings: dict[str, Tensor]
    readings: dict[str, Tensor]


class SupervisorStep:
    """The function of one schedule.

    Args:
        graph: nodes and connections.
        schedule: what runs when.
        device: where everything lives.
        uses: by node name, what each is known to read; filled as they run for the first time.

    Attributes:
        running: what is being called, for errors.
    """

    def __init__(
        self, graph: Graph, schedule: Schedule, device: torch.device, uses: dict[str, Uses] | None = None
    ) -> None:
        self.graph, self.schedule, self.device = graph, schedule, device
        self.tables = PassTables(graph, schedule, device)
        self.uses: dict[str, Uses] = {} if uses is None else uses
        self.running = "the supervisor step"
        self._kept: dict[Any, Tensor] = {}

    def begin(self, parameters: Mapping[str, State], carry: Carry) -> Carry:
        """Run up to the supervisor's first step."""
        return self._pass(parameters, carry, carry.rings[self.graph.supervisor][0], first=True)

    def advance(self, parameters: Mapping[str, State], carry: Carry, action: Tensor) -> Carry:
        """Give actions (B, M) and run everything up to the supervisor's next step."""
        name = self.graph.supervisor
        cells = self._cells(carry)
        cells.write(name, carry.step % cells.depth[name], None, action)
        after = Carry(carry.row, carry.step + 1, carry.nodes, cells.rings, carry.readings)
        return self._pass(parameters, after, action, first=False)

    def act(
        self,
        function: Callable[..., Tensor],
        parameters: Mapping[str, Tensor],
        carry: Carry,
        uses: dict[str, Uses],
        shown: Mapping[str, Tensor],
    ) -> Tensor:
        """Actions (B, M) of a policy from the readings, or from what the supervisor sees if there are none.

        Args:
            function: of its parameters and what it is shown.
            parameters: of the policy.
            carry: where the environments are.
            uses: of the policy alone, like that of the nodes.
            shown: signals (B, ...) that the policy sees beside.
        """
        self.running = "the policy"
        if carry.readings:
            return function(parameters, {**carry.readings, **shown})
        seen = self._supervisor_inputs(carry, uses.get("policy"))
        return self._watched("policy", seen, lambda: function(parameters, {**seen, **shown}), uses)

    def inputs(self, carry: Carry) -> dict[str, Input]:
        """What the supervisor sees at the step that waits, every field of it."""
        return self._supervisor_inputs(carry, None)

    def _pass(self, parameters: Mapping[str, State], carry: Carry, action: Tensor, *, first: bool) -> Carry:
        tables, nodes = self.tables, dict(carry.nodes)
        picked = self._pick(carry)
        running = picked[: len(tables.slots)] >= 0
        steps = picked[: len(tables.slots)].clamp(min=0)
        cells = self._cells(carry)
        for s, slot in enumerate(tables.slots):
            node = self.graph.nodes[slot.node]
            self.running = f'node "{node.name}"'
            # What the others see is that of their step 0; their results are not used.
            inputs = self._inputs(
                node.name, slot.reads, picked, carry.row, steps[s], cells.rings, self.uses.get(node.name)
            )
            own, output = self._watched(
                node.name,
                inputs,
                lambda node=node, inputs=inputs: call_step(
                    node, parameters[node.name], nodes[node.name], inputs
                ),
            )
            mask = None if slot.always and not first else running[s]
            nodes[node.name] = merged(node, mask, own, nodes[node.name])
            cells.write(node.name, picked[len(tables.slots) + s], mask, output, grow=first)
        self.running = "the supervisor step"
        after = Carry(carry.row, carry.step, nodes, cells.rings, carry.readings)
        return self._observe(parameters, after, action)

    def _observe(self, parameters: Mapping[str, State], carry: Carry, action: Tensor) -> Carry:
        name = self.graph.supervisor
        supervisor = self.graph.node(name)
        if not isinstance(supervisor, Supervisor) or type(supervisor).observe is Supervisor.observe:
            return carry
        self.running = f'node "{name}"'
        inputs = self._supervisor_inputs(carry, self.uses.get(name))
        own, readings = self._watched(
            name,
            inputs,
            lambda: call_observe(supervisor, parameters[name], carry.nodes[name], inputs, action),
        )
        own = merged(supervisor, None, own, carry.nodes[name])
        return Carry(carry.row, carry.step, carry.nodes | {name: own}, carry.rings, readings)

    def _pick(self, carry: Carry) -> Tensor:
        """The lines of the tables that the environments are at, (columns, B)."""
        lines = self.tables.lines.index_select(0, carry.row * self.tables.passes + carry.step)
        return lines.t().to(torch.int64, memory_format=torch.contiguous_format)

    def _supervisor_inputs(self, carry: Carry, uses: Uses | None) -> dict[str, Input]:
        name, reads = self.graph.supervisor, self.tables.supervisor
        return self._inputs(name, reads, self._pick(carry), carry.row, carry.step, carry.rings, uses)

    def _inputs(
        self,
        node: str,
        reads: Iterable[Read],
        picked: Tensor,
        row: Tensor,
        step: Tensor,
        rings: Mapping[str, Tensor],
        uses: Uses | None,
    ) -> dict[str, Input]:
        """What a node sees at its steps (B,); fields that it does not use are zeros."""
        layout, batch = self.schedule.timing.layout, len(row)
        found: dict[str, Input] = {}
        start: Tensor | None = None
        for edge, connection, columns in reads:
            ring, size, name = rings[connection.sender], connection.window, str(connection.name)
            if columns is None:
                data = ring[0].unsqueeze(1).expand(batch, size, *ring.shape[2:])
            else:
                data = ring[picked[columns].t(), self._range(batch)[:, None]]
            asked = [field for field in TIMES if uses is None or (name, field) in uses]
            place = None
            if set(asked) & {"seq", "t_sent", "t_received"}:
                width = self.schedule.timing.windows.shape[1]
                place = row * width + step * size + int(layout.window_base[edge])
                place = place[:, None] + self._range(size)
            fields = []
            for field in ("seq", "t_sent", "t_received"):
                dtype = torch.int64 if field == "seq" else torch.float64
                if place is not None and field in asked:
                    fields.append(self._table(field).take(place))
                else:
                    fields.append(self._zeros(dtype, batch, size))
            if "t_start" in asked and start is None:
                base = int(layout.step_base[self.graph.index[node]])
                start = self._table("t_start").take(row * self.schedule.timing.t_start.shape[1] + base + step)
            chosen = start if start is not None and "t_start" in asked else self._zeros(torch.float64, batch)
            found[name] = Input(connection.seen(data), *fields, t_start=chosen)
        return found

    def _cells(self, carry: Carry) -> Cells:
        depth = {n.name: cells for n, cells in zip(self.graph.nodes, self.tables.depth, strict=True)}
        return Cells(carry.rings, depth, self._range(len(carry.row)))

    def _table(self, field: str) -> Tensor:
        return getattr(self.schedule, field).to(self.device)

    def _zeros(self, dtype: torch.dtype, *shape: int) -> Tensor:
        if (dtype, shape) not in self._kept:
            self._kept[dtype, shape] = torch.zeros(shape, dtype=dtype, device=self.device)
        return self._kept[dtype, shape]

    def _range(self, size: int) -> Tensor:
        if ("range", size) not in self._kept:
            self._kept["range", size] = torch.arange(size, device=self.device)
        return self._kept["range", size]

    def _watched(
        self,
        key: str,
        inputs: Mapping[str, Input],
        function: Callable[[], Any],
        uses: dict[str, Uses] | None = None,
    ) -> Any:
        """Call a function, and the first time take note of which fields of its inputs it reads."""
        uses = self.uses if uses is None else uses
        if key in uses:
            return function()
        with Watching() as watching:
            result = function()
        watching.note(tree_leaves(result))
        uses[key] = frozenset(
            (name, field)
            for name, seen in inputs.items()
            for field in TIMES
            if id(getattr(seen, field)) in watching.used
        )
        return result
