"""The nodes of a pool: water, heater, pump, thermometer, and the age of what the thermometer shows."""

from deepkoco.engines.pool.devices import Actuator, Probe
from deepkoco.engines.pool.flow_delay import FlowDelay
from deepkoco.engines.pool.world import PoolWorld

__all__ = ["Actuator", "FlowDelay", "PoolWorld", "Probe"]
