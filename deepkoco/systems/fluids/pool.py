"""A heated pool whose thermometer sits at the end of a pipe.

A pump draws water from the pool at the flow q, through a pipe of volume V, past a thermometer and a heater, and back:

    rho c W dT/dt = P + q rho c (T_out - T) - U (T - T_air) - D        the pool, well mixed
    T_out(t) = T(t - tau),  integral of q from t - tau to t = V        the pipe, in plug flow

T is the temperature of the pool, T_out that at the end of the pipe, P the heat of the heater and D that of fresh cold
water. The heat of the water leaves the pool with one temperature and comes back with another, so none gets lost in the
pipe. Within a tick q, P, D and T_out are constant: T then follows an exponential, whose mean enters the pipe.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.fluids.plug_flow import (
    PipeFluid,
    displaced_content,
    fill_pipe,
    outlet_value,
    pipe_content,
    push_fluid,
)
from deepkoco.systems.parameter import Parameter, Parameters

HEAT_CAPACITY = 4.18e6
"""rho c of water [J/(m3 K)]."""
CELLS = 60
"""Elements of the pipe; at the lowest flow a tick of 1 s moves a fifth of one."""
TEMPERATURE, ENTERED = 0, 1
"""What an element of the pipe carries: its temperature [deg C], and when it entered [s]."""

POOL_PARAMETERS: dict[str, tuple[Parameter, ...]] = {
    "world": (
        Parameter("pool_volume", 3.0, "m3", 0.5, 50.0, 0.1, "W, water in the pool"),
        Parameter("pipe_volume", 0.06, "m3", 0.005, 0.5, 0.02, "V, water in the pipe: 30 m of 50 mm"),
        Parameter("heat_loss", 250.0, "W/K", 0.0, 5000.0, 100.0, "U, to the air"),
        Parameter("air_temperature", 18.0, "deg C", -20.0, 40.0, 2.0, "T_air, around the pool"),
        Parameter("refill_heat", 0.0, "W", 0.0, 1e6, 1e4, "D while fresh cold water flows in"),
        Parameter("refill_start", 900.0, "s", 0.0, 1e6, 100.0, "when it begins to"),
        Parameter("refill_time", 300.0, "s", 0.0, 1e6, 60.0, "for how long it does"),
    ),
    "heater": (
        Parameter("scale", 36e3, "W", 1e3, 1e6, 2e3, "P at full power"),
        Parameter("lag", 30.0, "s", 0.0, 600.0, 10.0, "time constant of the heater"),
    ),
    "pump": (
        Parameter("scale", 1.5e-3, "m3/s", 1e-5, 0.1, 1e-4, "q at full speed"),
        Parameter("lag", 4.0, "s", 0.0, 60.0, 1.0, "time constant of the pump"),
    ),
    "probe": (Parameter("lag", 15.0, "s", 0.0, 300.0, 5.0, "time constant of the thermometer in its well"),),
}
"""Of each node of a pool. The nodes are in `deepkoco.engines.pool`."""


def pool_parameters() -> dict[str, dict[str, Tensor]]:
    """Nominal values by node and name, float64."""
    return {
        node: {p.name: torch.tensor(p.value, dtype=torch.float64) for p in parameters}
        for node, parameters in POOL_PARAMETERS.items()
    }


class PoolState(NamedTuple):
    """The water.

    Attributes:
        temperature: (B,) of the pool [deg C].
        pipe: What is in the pipe: of each element its temperature and the time at which it entered.
    """

    temperature: Tensor
    pipe: PipeFluid


def start_pool(temperature: Tensor, parameters: Parameters, cells: int = CELLS) -> PoolState:
    """All water (B,) at one temperature [deg C], that in the pipe as if it had entered at time 0."""
    value = torch.stack([temperature, torch.zeros_like(temperature)], -1)
    return PoolState(temperature, fill_pipe(value, parameters["pipe_volume"], cells))


def pool_tick(
    state: PoolState,
    heat: Tensor,
    flow: Tensor,
    time: Tensor,
    dt: float,
    parameters: Parameters,
    cells: int = CELLS,
) -> tuple[PoolState, Tensor]:
    """Go on by a tick.

    Args:
        state: At its begin.
        heat: (B,) P - D, mean over the tick [W].
        flow: (B,) q, mean over the tick, at least 0 [m3/s].
        time: (B,) of its begin [s].
        dt: Its length [s].
        parameters: Of the pool.
        cells: As for `start_pool`.

    Returns:
        The state at its end, and the mean (B, 2) of what came to the end of the pipe: temperature and time of entry.
    """
    volume, pipe_volume = flow * dt, parameters["pipe_volume"]
    capacity = HEAT_CAPACITY * parameters["pool_volume"]
    exchange = HEAT_CAPACITY * flow / capacity  # [1/s]
    rate = exchange + parameters["heat_loss"] / capacity
    gain = (
        parameters["heat_loss"] * parameters["air_temperature"] + heat
    ) / capacity  # without the pipe's [K/s]
    # What comes out entered long before; only of a pipe that turns over within the tick a share is new.
    old, own = displaced_content(state.pipe, volume, pipe_volume)
    moves = volume > 0.0
    safe = torch.where(moves, volume, 1.0)
    known, share = old[:, TEMPERATURE] / safe, own / safe
    # T' = gain + exchange T_out - rate T, and T_out = known + share (mean of T).
    grown = dt * _mean_growth(rate * dt)
    start = state.temperature
    mean = (start + (gain + exchange * known - rate * start) * grown) / (1.0 - share * exchange * grown)
    drive = gain + exchange * (known + share * mean) - rate * start
    after = start + drive * dt * _mean_decay(rate * dt)
    entering = torch.stack([mean, time + 0.5 * dt], -1)
    pipe, left = push_fluid(state.pipe, volume, entering, pipe_volume, cells)
    return PoolState(after, pipe), left.mean


def pool_energy(state: PoolState, parameters: Parameters) -> Tensor:
    """Heat (B,) of the water in pool and pipe, against 0 deg C [J]."""
    held = pipe_content(state.pipe)[:, TEMPERATURE]
    return HEAT_CAPACITY * (parameters["pool_volume"] * state.temperature + held)


def _mean_decay(x: Tensor) -> Tensor:
    """(1 - exp(-x)) / x; for x up to 0.1 as a series, to 3e-12, which has no 0 by 0."""
    series = 1.0 - x / 2 * (1.0 - x / 3 * (1.0 - x / 4 * (1.0 - x / 5 * (1.0 - x / 6 * (1.0 - x / 7)))))
    safe = torch.where(x > 0.1, x, 1.0)
    return torch.where(x > 0.1, (1.0 - torch.exp(-safe)) / safe, series)


def _mean_growth(x: Tensor) -> Tensor:
    """(1 - (1 - exp(-x)) / x) / x: the mean over the tick of what `_mean_decay` is at its end."""
    series = 0.5 * (1.0 - x / 3 * (1.0 - x / 4 * (1.0 - x / 5 * (1.0 - x / 6 * (1.0 - x / 7)))))
    safe = torch.where(x > 0.1, x, 1.0)
    return torch.where(x > 0.1, (1.0 - (1.0 - torch.exp(-safe)) / safe) / safe, series)


def at_outlet(state: PoolState) -> Tensor:
    """What leaves the pipe next, (B, 2): its temperature [deg C] and when it entered [s]."""
    return outlet_value(state.pipe)
