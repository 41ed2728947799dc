"""The state estimator of an environment on the delay graph, between its sensor and its agent."""

from __future__ import annotations

import math

from deepkoco.envs.settings import EnvironmentSettings, SettingsError
from deepkoco.envs.task_randomization import ESTIMATOR
from deepkoco.envs.tasks import Task
from deepkoco.fit.state.estimator_node import StateEstimator
from deepkoco.fit.state.unscented import FilterError
from deepkoco.graph import Connection
from deepkoco.graph.delay import Delay
from deepkoco.systems import System

START_POSITION, START_SPEED = 3.0, 10.0  # spread before the first measurement [rad or m; per second]
MOST_MESSAGES = 6  # measurements taken in at a tick; each is a part of the compiled step


def between_sensor_and_agent(
    scene: System,
    task: Task,
    settings: EnvironmentSettings,
    sensing: Delay,
    actuation: Delay,
    sensor_rate: float,
) -> tuple[StateEstimator, list[Connection]]:
    """The node and its connections.

    Args:
        scene: The system with what the task adds; the model of the filter.
        task: Gives the rate and the limits of commands.
        settings: Of the environment.
        sensing, actuation: Delays from the sensor and to the world.
        sensor_rate: Measurements per second [Hz].

    Raises:
        SettingsError: The filter cannot be made for this system.
    """
    rate, period = task.control_rate, 1.0 / sensor_rate
    spread = (0.0, settings.process_noise**2)
    joints, states = scene.joints, len(scene.state_names)
    # Of states behind the positions and speeds nothing is known; their own unit is taken for the speeds'.
    of_state = [spread[min(i // joints, 1)] for i in range(states)]
    limit = task.speed_limit if math.isfinite(task.speed_limit) else START_SPEED
    start = [START_POSITION if i < joints else limit for i in range(states)]
    # A sensor that declares no noise still rounds and drifts: a share of what it can show.
    noise = [c.noise_sd or 1e-4 * min(max(abs(c.low), abs(c.high)), 10.0) for c in scene.measurements]
    limits = tuple(
        (max(-most, c.low), min(most, c.high))
        for most, c in zip(task.command_limits, scene.commands, strict=True)
    )
    # Messages are taken in at ticks, so the oldest that is new has waited for up to a period of the agent.
    late = (float(sensing.mean) if sensing.constant else sensing.highest) + period
    try:
        node = StateEstimator(
            scene,
            rate,
            tuple(of_state),
            tuple(noise),
            ahead=float(actuation.mean) if settings.estimator == "predicted" else None,
            actuation_delay=float(actuation.mean),
            measurement_period=period,
            latest=float(sensing.mean) + period,
            start_sd=tuple(start),
            command_limits=limits,
            name=ESTIMATOR,
        )
    except FilterError as error:
        raise SettingsError(f"estimator: {error}") from error
    new = min(1 + math.ceil(sensor_rate / rate), MOST_MESSAGES)
    sent = node.commands_needed(late + 1.0 / rate, rate)
    return node, [
        Connection("sensor", ESTIMATOR, delay=sensing, window=new),
        Connection("agent", ESTIMATOR, window=sent, skip=True),
        Connection(ESTIMATOR, "agent", name="sensor"),
    ]
