"""The water of a pool and of its pipe, as a node."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.engines.hold import mean_over_tick
from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.fluids import PipeFluid, PoolState, pool_parameters, pool_tick, start_pool
from deepkoco.systems.fluids.pool import CELLS, ENTERED, TEMPERATURE

START_TEMPERATURE = 28.0  # where nothing else is given [deg C]


class PoolWorld(Node):
    """A heated pool with its pipe, one tick at a time; tick 0 puts out the start.

    The transport delay is in the state of this node, because it depends on the flow, which the node hears only when it
    runs: no connection can have it. See `deepkoco.systems.fluids`.

    Inputs: ``heater`` (B, 1), heat [W], and ``pump`` (B, 1), flow [m3/s], with windows that hold the messages of a
    tick.

    Output, in parts, (B,) each: ``pool``, its temperature, and ``outlet``, the temperature at the end of the pipe, mean
    over the tick [deg C]; ``flow``, mean over the tick [m3/s]; ``age``, how long ago the water at the end of the
    pipe entered, at the end of the tick [s].

    Args:
        rate: Ticks per second [Hz].
        cells: Elements of the pipe.
    """

    inputs = ("heater", "pump")
    outputs = {name: ((), torch.float64) for name in ("pool", "outlet", "flow", "age")}  # noqa: RUF012

    def __init__(self, rate: float = 1.0, cells: int = CELLS) -> None:
        super().__init__("world", rate)
        self.cells = cells

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return self.start(torch.full((batch,), START_TEMPERATURE, dtype=torch.float64))

    def start(self, temperature: Tensor) -> State:
        """The state in which all water is at one temperature (B,) [deg C].

        Edges are kept as shares of the volume of the pipe, so a start does not depend on parameters.
        """
        state = start_pool(temperature, {"pipe_volume": torch.ones((), dtype=torch.float64)}, self.cells)
        return {
            "temperature": temperature,
            "edges": state.pipe.edges,
            "values": state.pipe.values,
            "time": torch.zeros_like(temperature),
            "started": torch.zeros(len(temperature), dtype=torch.bool),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> dict[str, Tensor]:
        zero = torch.zeros_like(state["temperature"])
        return {"pool": state["temperature"], "outlet": state["temperature"], "flow": zero, "age": zero}

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, dt: float
    ) -> tuple[State, dict[str, Tensor]]:
        own, started, time = self._complete(parameters), state["started"], state["time"]
        heat = mean_over_tick(inputs["heater"].data[..., 0], inputs["heater"], dt)
        flow = mean_over_tick(inputs["pump"].data[..., 0], inputs["pump"], dt).clamp_min(0.0)
        # Fresh water over the share of the tick in which it flows in.
        begin = torch.maximum(time, own["refill_start"])
        end = torch.minimum(time + dt, own["refill_start"] + own["refill_time"])
        heat = heat - own["refill_heat"] * (end - begin).clamp_min(0.0) / dt
        size = own["pipe_volume"].expand(len(time))[:, None]
        before = PoolState(state["temperature"], PipeFluid(state["edges"] * size, state["values"]))
        after, outlet = pool_tick(before, heat, flow, time, dt, own, self.cells)
        # The first tick has nothing behind it.
        now = time + torch.where(started, dt, 0.0)
        wide = started[:, None]
        kept = {
            "temperature": torch.where(started, after.temperature, before.temperature),
            "edges": torch.where(wide, after.pipe.edges / size, state["edges"]),
            "values": torch.where(wide[..., None], after.pipe.values, before.pipe.values),
            "time": now,
            "started": torch.ones_like(started),
        }
        shown = {
            "pool": kept["temperature"],
            "outlet": torch.where(started, outlet[:, TEMPERATURE], before.temperature),
            "flow": torch.where(started, flow, 0.0),
            # The mean of the tick left half a tick before its end.
            "age": torch.where(started, now - 0.5 * dt - outlet[:, ENTERED], 0.0),
        }
        return kept, shown

    def _complete(self, parameters: Parameters) -> dict[str, Tensor]:
        return {**_NOMINAL, **parameters}


_NOMINAL = pool_parameters()["world"]
