"""Runtimes of one environment: simulated event by event, concurrent in threads and processes, in real time."""

from deepkoco.graph.realtime.concurrent import ConcurrentRuntime
from deepkoco.graph.realtime.failure import NodeFailure
from deepkoco.graph.realtime.measured import MessageTimes, NodeTimes, message_times, node_times
from deepkoco.graph.realtime.protocol import ProtocolError, ProtocolPlan
from deepkoco.graph.realtime.simulated import SimulatedRuntime
from deepkoco.graph.realtime.state import RunningState
from deepkoco.graph.realtime.wallclock import WallClockRuntime

__all__ = [
    "ConcurrentRuntime",
    "MessageTimes",
    "NodeFailure",
    "NodeTimes",
    "ProtocolError",
    "ProtocolPlan",
    "RunningState",
    "SimulatedRuntime",
    "WallClockRuntime",
    "message_times",
    "node_times",
]
