"""The graph of a pendulum before a camera, and the log that a recording of it makes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from deepkoco.engines.ode import World
from deepkoco.graph import Connection, Episode, Graph, Supervisor
from deepkoco.graph.delay import Delay
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import System, make_system
from deepkoco.vision.camera import Camera
from deepkoco.vision.picture import Scene
from deepkoco.vision.readers import AngleReader, BackgroundSubtraction, ColourMask, EllipseFinder
from deepkoco.vision.tachometer import Tachometer

CHAIN = ("camera", "moved", "coloured", "ellipse", "angle")
"""Nodes from the picture to the angle."""
LEAST = 0.75
"""Share of the mass that must be seen: one that is half hidden by the background has its middle elsewhere."""
WORLD_RATE, CAMERA_RATE, TACHO_RATE, CONTROL_RATE = 500.0, 50.0, 100.0, 50.0  # [Hz]


def camera_chain(
    scene: Scene,
    background: np.ndarray | None = None,
    *,
    system: System | None = None,
    world_rate: float = WORLD_RATE,
    camera_rate: float = CAMERA_RATE,
    actuation_delay: Delay | float | dict[str, Any] = 0.0,
    readout: Delay | float | dict[str, Any] = 0.002,
    transport: Delay | float | dict[str, Any] = 0.004,
    times: dict[str, float] | None = None,
    noise: float = 4.0,
) -> Graph:
    """World, camera, the four nodes that read its pictures, a tachometer, and the agent.

    Args:
        scene: What the camera looks at.
        background: What the reader takes for still, uint8 (H, W, 3); None takes the scene's own backdrop.
        system: Dynamics of one joint; None takes the `pendulum`.
        world_rate, camera_rate: [Hz].
        actuation_delay: From the agent to the motor; in no record of a robot.
        readout, transport: Of a picture; a record has them.
        times: Largest times of the camera that its window must hold, as for `Camera.states_needed`.
        noise: Standard deviation of a pixel, of 255.
    """
    system = make_system("pendulum") if system is None else system
    background = scene.backdrop if background is None else background
    work = 5e-4  # of a reader at 160 pixels [s]
    nodes = [
        World(system, world_rate),
        Camera(camera_rate, scene, noise, delay=readout),
        BackgroundSubtraction(camera_rate, background, delay=work),
        ColourMask(camera_rate, background, scene.colour, delay=work),
        EllipseFinder(camera_rate, LEAST * scene.area, delay=work),
        AngleReader(camera_rate, scene.side),
        Tachometer(TACHO_RATE),
        Supervisor("agent", CONTROL_RATE, initial_action=torch.zeros(1, dtype=torch.float64)),
    ]
    connections = [
        Connection("world", "camera", window=Camera.states_needed(world_rate, times)),
        Connection("camera", "moved", delay=transport, blocking=True),
        Connection("moved", "coloured", blocking=True),
        Connection("coloured", "ellipse", blocking=True),
        Connection("ellipse", "angle", blocking=True),
        Connection("world", "tachometer"),
        Connection("angle", "agent"),
        Connection("tachometer", "agent"),
        # Ticks of the world may hold two commands: a window for the one before.
        Connection("agent", "world", delay=actuation_delay, window=2, skip=True),
    ]
    return Graph(nodes, connections)


def source_starts(graph: Graph, episode: Episode, path: Sequence[str]) -> np.ndarray:
    """When the first node of a path started the step that each step of the last node rests on, (K,) [s].

    It follows the newest message that each step saw back through the record; NaN where that was the initial output.

    Args:
        graph: What was recorded.
        episode: The record.
        path: Names of nodes, each connected to the next.

    Raises:
        ValueError: Two neighbours of the path are not connected, or the record has no windows between them.
    """
    seq = np.arange(len(episode.outputs[path[-1]]))
    there = np.ones(len(seq), dtype=bool)
    for sender, receiver in zip(path[-2::-1], path[:0:-1], strict=True):
        key = next((c.key for c in graph.connections if (c.sender, c.receiver) == (sender, receiver)), None)
        if key is None or key not in episode.windows:
            raise ValueError(f'the record has no messages from "{sender}" to "{receiver}"')
        newest = episode.windows[key][:, -1]
        there &= (seq >= 0) & (seq < len(newest))
        seq = newest[np.clip(seq, 0, len(newest) - 1)]
    there &= seq >= 0
    starts = episode.t_start[path[0]]
    return np.where(there, starts[np.clip(seq, 0, len(starts) - 1)], np.nan)


def seen_log(graph: Graph, episode: Episode, tachometer: bool = True) -> Recording:
    """The log for a fit of `SeenPendulum`: commands when they were sent, angles when their picture was stamped.

    Times on the way from the picture to the angle are in the record, and so are not part of the camera's delay.
    Pictures in which nothing was found are left out.

    Args:
        graph: Of `camera_chain`.
        episode: One of its episodes.
        tachometer: Whether the log has the speed.
    """
    stamps, seen = source_starts(graph, episode, CHAIN), episode.outputs["angle"]
    good = np.isfinite(stamps) & np.isfinite(seen).all(1)
    commands = episode.outputs["agent"][:, 0]
    sent = episode.t_start["agent"][: len(commands)]
    channels = {
        "voltage": Series(sent, commands, "V", "command"),
        "bearing": Series(stamps[good], seen[good, 0], "rad", "measurement"),
        "reach": Series(stamps[good], seen[good, 1], "1", "measurement"),
    }
    if tachometer:
        speeds = episode.outputs["tachometer"][:, 0]
        channels["omega"] = Series(
            episode.t_start["tachometer"][: len(speeds)], speeds, "rad/s", "measurement"
        )
    return Recording(channels, None, "seen_pendulum", {"camera_rate_hz": float(graph.node("camera").rate)})
