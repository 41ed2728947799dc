"""The graph of box pushing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from deepkoco.engines.boxpush import (
    BoxCamera,
    BoxPushWorld,
    Encoders,
    InverseKinematics,
    JointGuard,
    JointMotion,
    Retreat,
    world_start,
)
from deepkoco.engines.boxpush.motion import JOINT_SPEED, TOOL_SPEED
from deepkoco.engines.boxpush.retreat import home_angles
from deepkoco.engines.boxpush.sensors import CAMERA_NOISE
from deepkoco.envs.boxpush.seat import BoxPushSeat
from deepkoco.graph import Connection, Graph
from deepkoco.graph.delay import make_delay
from deepkoco.graph.model.connection import wide_enough
from deepkoco.graph.model.node import State
from deepkoco.systems.boxpush import tool_pose

CONTROL_RATE, SERVO_RATE = 10.0, 20.0
CAMERA_DELAY = {"law": "uniform", "low": 0.12, "high": 0.18}
ACTUATION_DELAY = {"law": "uniform", "low": 0.02, "high": 0.04}
SENSING_DELAY = 0.005
DECISION_TIME = 0.08
"""What a decision takes [s]."""


@dataclass(frozen=True)
class BoxPushOptions:
    """How arm and box are measured and controlled.

    Attributes:
        inverse_kinematics: An action is a planar velocity of the tool (2); else six joint speeds.
        history: Past actions in the agent's observation.
        noise: Encoders and camera have noise.
        sensing_delay: From the encoders to the agent [s], a number, a law or its description.
        camera_delay: From the camera to the agent.
        decision_time: Of the agent.
        actuation_delay: From the agent to the arm's computer.
        time_step: Longest step of the physics [s]; None: that of the model.
        threads: Of `mujoco.rollout`; 0: the caller's.
    """

    inverse_kinematics: bool = True
    history: int = 4
    noise: bool = True
    sensing_delay: Any = SENSING_DELAY
    camera_delay: Any = None
    decision_time: Any = DECISION_TIME
    actuation_delay: Any = None
    time_step: float | None = None
    threads: int = 0

    @property
    def entries(self) -> int:
        """Of an action."""
        return 2 if self.inverse_kinematics else 6


def box_push_graph(options: BoxPushOptions | None = None) -> Graph:
    """World, sensors, agent, and the way of its actions: motion, retreat, guard.

    Args:
        options: See there.

    Raises:
        ValueError: A delay or a rate is none.
    """
    options = options or BoxPushOptions()
    world = BoxPushWorld(SERVO_RATE, options.threads, options.time_step)
    guard = JointGuard(SERVO_RATE)
    camera = CAMERA_DELAY if options.camera_delay is None else options.camera_delay
    actuation = ACTUATION_DELAY if options.actuation_delay is None else options.actuation_delay
    nodes = [
        world,
        Encoders(SERVO_RATE, options.noise),
        BoxCamera(CONTROL_RATE, CAMERA_NOISE if options.noise else (0.0, 0.0)),
        InverseKinematics(SERVO_RATE) if options.inverse_kinematics else JointMotion(SERVO_RATE),
        Retreat(SERVO_RATE),
        guard,
        BoxPushSeat(CONTROL_RATE, options.entries, options.history, make_delay(options.decision_time)),
    ]
    connections = [
        Connection("world", "encoders"),
        Connection("world", "camera"),
        Connection("world", "agent"),
        Connection("encoders", "agent", delay=make_delay(options.sensing_delay)),
        Connection("encoders", "retreat"),
        Connection("encoders", "guard"),
        Connection("camera", "agent", delay=make_delay(camera)),
        Connection("guard", "agent", name="goals"),
        Connection("agent", "motion", delay=make_delay(actuation), skip=True, name="command"),
        Connection("motion", "retreat", name="command"),
        Connection("retreat", "guard", name="command"),
        wide_enough(Connection("guard", "world", skip=True, name="command"), guard, world),
    ]
    return Graph(nodes, connections)


def box_push_start(
    graph: Graph,
    box: Tensor,
    goal: Tensor,
    angles: Tensor | None = None,
    speeds: Tensor | None = None,
    goals: Tensor | None = None,
    first: Tensor | None = None,
) -> dict[str, State]:
    """Start states by node.

    Args:
        graph: Of box pushing.
        box: (B, 3) place along x and y [m] and turn [rad] of the box, at rest.
        goal: (B, 2) its goal [m].
        angles: (B, 6) of the joints [rad]; None: the arm is at home.
        speeds: (B, 6) of the joints [rad/s]; None: at rest.
        goals: (B, 6) that the servos have been sent [rad]; None: the angles.
        first: (B, M) action that holds before the first one, and whose tick at the start has led to the goals; None:
            zero.
    """
    batch = len(box)
    angles = home_angles()[1:].expand(batch, 6).clone() if angles is None else angles
    speeds = torch.zeros_like(angles) if speeds is None else speeds
    goals = angles if goals is None else goals
    world: Any = graph.node("world")
    agent: State = {"goal": goal} if first is None else {"goal": goal, "first": first}
    node = graph.node("motion")
    # The goals that are seen contain the tick of that instant, which the graph carries out at its start.
    tick = 0.0 if first is None else first / float(node.rate)
    motion: State = {"goals": goals}
    if isinstance(node, InverseKinematics):
        motion["point"] = tool_pose(goals).place[:, :2] - TOOL_SPEED * tick
    elif first is not None:
        motion["goals"] = goals - JOINT_SPEED * tick
    return {
        "world": world_start(world, box, angles, speeds),
        "encoders": {"start": torch.cat([angles, speeds], -1)},
        "camera": {"start": box},
        "motion": motion,
        "retreat": {"goals": goals},
        "guard": {"goals": goals},
        "agent": agent,
    }
