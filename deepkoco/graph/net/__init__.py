"""A graph on two machines: nodes at a robot, led over TCP by a runtime on another computer."""

from deepkoco.graph.net.failure import ConnectionRefused, LinkFailure
from deepkoco.graph.net.leader import RobotNodes, connect
from deepkoco.graph.net.merge import merge_recordings
from deepkoco.graph.net.robot_end import RobotEnd
from deepkoco.graph.net.robot_options import RobotOptions

__all__ = [
    "ConnectionRefused",
    "LinkFailure",
    "RobotEnd",
    "RobotNodes",
    "RobotOptions",
    "connect",
    "merge_recordings",
]
