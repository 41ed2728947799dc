"""A pool whose thermometer sits behind a pipe: its graph, with filter and controller, and its environment."""

from deepkoco.envs.pool.pool_graph import FILTERS, LONGEST_AGE, PoolOptions, pool_graph, pool_start
from deepkoco.envs.pool.seat import PoolSeat

__all__ = ["FILTERS", "LONGEST_AGE", "PoolOptions", "PoolSeat", "pool_graph", "pool_start"]
