"""The nodes of a pool: water, heater, pump, thermometer and what estimates and controls them."""

from deepkoco.engines.pool.assembly import FILTERS, LONGEST_AGE, PoolOptions, pool_graph, pool_start
from deepkoco.engines.pool.seat import PoolSeat

__all__ = ["FILTERS", "LONGEST_AGE", "PoolOptions", "PoolSeat", "pool_graph", "pool_start"]
