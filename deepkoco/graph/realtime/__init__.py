"""Runtimes of one environment: simulated event by event, concurrent in threads and processes, in real time."""

from deepkoco.graph.realtime.failure import NodeFailure
from deepkoco.graph.realtime.protocol import ProtocolError, ProtocolPlan
from deepkoco.graph.realtime.simulated import SimulatedRuntime
from deepkoco.graph.realtime.state import RunningState

__all__ = ["NodeFailure", "ProtocolError", "ProtocolPlan", "RunningState", "SimulatedRuntime"]
