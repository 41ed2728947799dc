"""The geometry of a small 6-DOF arm: six hinges, a stick as its tool."""

from __future__ import annotations

from typing import NamedTuple


class ArmJoint(NamedTuple):
    """A hinge of the arm, and the link that it moves.

    Attributes:
        name: Of the joint.
        axis: It turns about this axis of its frame: x, y or z.
        offset: From the hinge before it, in that one's frame [m].
        low, high: Its range [rad].
        mass: Of the link [kg].
        gain: Torque of the servo per error [N m/rad].
        damping: Torque of the servo per speed [N m s/rad].
        torque: Largest torque of the servo [N m].
    """

    name: str
    axis: str
    offset: tuple[float, float, float]
    low: float
    high: float
    mass: float
    gain: float
    damping: float
    torque: float


JOINTS = (
    ArmJoint("waist", "z", (0.0, 0.0, 0.070), -3.1, 3.1, 0.6, 200.0, 12.0, 10.0),
    ArmJoint("shoulder", "y", (0.0, 0.0, 0.057), -1.80, 1.25, 0.8, 200.0, 12.0, 20.0),
    ArmJoint("elbow", "y", (0.06, 0.0, 0.30), -1.75, 1.60, 0.4, 200.0, 10.0, 15.0),
    ArmJoint("forearm_roll", "x", (0.20, 0.0, 0.0), -3.1, 3.1, 0.2, 60.0, 2.0, 5.0),
    ArmJoint("wrist_angle", "y", (0.10, 0.0, 0.0), -1.86, 2.10, 0.2, 60.0, 2.0, 5.0),
    ArmJoint("wrist_rotate", "x", (0.07, 0.0, 0.0), -3.1, 3.1, 0.2, 60.0, 2.0, 3.0),
)
"""With all angles at 0 the upper arm stands upright and everything behind the elbow points ahead; the lengths are
those on the data sheet of a ViperX 300. The gains let the shoulder sag by about a hundredth of a radian, as servos of
this kind do."""

TOOL = 0.108
"""From the last hinge to the tip of the tool, along x [m]."""
TOOL_RADIUS = 0.012
"""The tool is a round stick [m]."""
TOOL_HEIGHT = 0.04
"""Of the tip over the table while it pushes [m]."""
HOME = (0.22, 0.0)
"""Where the tool waits between episodes, x and y [m]."""
