"""Fluids: plug flow through pipes, and what is made of pipes and tanks."""

from deepkoco.systems.fluids.plug_flow import (
    Displaced,
    PipeFluid,
    displaced_content,
    fill_pipe,
    outlet_value,
    pipe_content,
    push_fluid,
    swept_time,
)
from deepkoco.systems.fluids.pool import (
    POOL_PARAMETERS,
    PoolState,
    pool_energy,
    pool_parameters,
    pool_tick,
    start_pool,
)

__all__ = [
    "POOL_PARAMETERS",
    "Displaced",
    "PipeFluid",
    "PoolState",
    "displaced_content",
    "fill_pipe",
    "outlet_value",
    "pipe_content",
    "pool_energy",
    "pool_parameters",
    "pool_tick",
    "push_fluid",
    "start_pool",
    "swept_time",
]
