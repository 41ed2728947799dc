"""Runtimes of one environment: simulated event by event, concurrent in threads and processes, in real time."""

from deepkoco.graph.live.concurrent import ConcurrentRuntime
from deepkoco.graph.live.failure import NodeFailure
from deepkoco.graph.live.measured import MessageTimes, NodeTimes, message_times, node_times
from deepkoco.graph.live.protocol import ProtocolError, ProtocolPlan
from deepkoco.graph.live.simulated import SimulatedRuntime
from deepkoco.graph.live.state import RunningState
from deepkoco.graph.live.wallclock import WallClockRuntime

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
