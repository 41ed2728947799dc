"""The nodes of box pushing: world, encoders, camera, inverse kinematics, the retreat between episodes, the guard."""

from deepkoco.engines.boxpush.guard import JointGuard
from deepkoco.engines.boxpush.motion import InverseKinematics, JointMotion
from deepkoco.engines.boxpush.retreat import Retreat
from deepkoco.engines.boxpush.sensors import BoxCamera, Encoders
from deepkoco.engines.boxpush.world import BoxPushWorld, box_state, world_start

__all__ = [
    "BoxCamera",
    "BoxPushWorld",
    "Encoders",
    "InverseKinematics",
    "JointGuard",
    "JointMotion",
    "Retreat",
    "box_state",
    "world_start",
]
