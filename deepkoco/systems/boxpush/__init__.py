"""An arm that pushes a box over a table: the arm's geometry, its kinematics, the MJCF model, and a picture."""

from deepkoco.systems.boxpush.arm import HOME, JOINTS, TOOL_HEIGHT, ArmJoint
from deepkoco.systems.boxpush.kinematics import ToolPose, solve_joints, tool_pose, tool_step
from deepkoco.systems.boxpush.model import BOX_HALF, BOX_MASS, FRICTION, box_push_model

__all__ = [
    "BOX_HALF",
    "BOX_MASS",
    "FRICTION",
    "HOME",
    "JOINTS",
    "TOOL_HEIGHT",
    "ArmJoint",
    "ToolPose",
    "box_push_model",
    "solve_joints",
    "tool_pose",
    "tool_step",
]
