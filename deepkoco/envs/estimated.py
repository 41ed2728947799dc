"""The state estimator of an environment on the delay graph, between its sensor and its agent."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deepkoco.envs.action_range import command_range
from deepkoco.envs.settings import EnvironmentSettings, SettingsError
from deepkoco.envs.task_randomization import ESTIMATOR
from deepkoco.envs.tasks import Task
from deepkoco.fit.state.estimator_node import StateEstimator
from deepkoco.fit.state.lags import LagStates, mean_further_delay
from deepkoco.fit.state.unscented import FilterError
from deepkoco.graph import Connection
from deepkoco.graph.delay import Delay
from deepkoco.systems import System

START_POSITION, START_SPEED = 3.0, 10.0  # spread before the first measurement [rad or m; per second]
START_EFFORT, EFFORT_NOISE = (
    0.1,
    0.1,
)  # of actuators that lag, as a share of their range; per root of a second
MOST_MESSAGES = 6  # measurements taken in at a tick; each is a part of the compiled step


@dataclass(frozen=True)
class FilterSettings:
    """What a filter of a task's system takes for granted.

    Attributes:
        noise_density: (S + E,) spectral density of the process noise of each state, and of each effort that lags.
        noise_sd: (N,) standard deviation of each sensor, in the channel's unit.
        start_sd: (S + E,) standard deviation before the first measurement.
    """

    noise_density: tuple[float, ...]
    noise_sd: tuple[float, ...]
    start_sd: tuple[float, ...]


def filter_settings(scene: System, task: Task, process_noise: float) -> FilterSettings:
    """Settings for a task on a system.

    Args:
        scene: The system with what the task adds to it.
        task: Limits the speeds.
        process_noise: As for `EnvironmentSettings`.
    """
    joints, states = scene.joints, len(scene.state_names)
    # Of states behind the positions and speeds nothing is known; they get what the speeds get.
    limit = task.speed_limit if math.isfinite(task.speed_limit) else START_SPEED
    low, high = command_range(task.command_limits, scene)
    # A command without limits says nothing about the size of its effort.
    ranges = [float(r) if math.isfinite(r) else 1.0 for r in 0.5 * (high - low)]
    lagging = [ranges[k] for k in LagStates(scene).commands]
    return FilterSettings(
        (
            *(0.0 if i < joints else process_noise**2 for i in range(states)),
            *((EFFORT_NOISE * size) ** 2 for size in lagging),
        ),
        # A sensor that declares no noise still rounds and drifts: a share of what it can show.
        tuple(c.noise_sd or 1e-4 * min(max(abs(c.low), abs(c.high)), 10.0) for c in scene.measurements),
        (
            *(START_POSITION if i < joints else limit for i in range(states)),
            *(START_EFFORT * size for size in lagging),
        ),
    )


def between_sensor_and_agent(
    scene: System,
    task: Task,
    settings: EnvironmentSettings,
    sensing: Delay,
    actuation: float,
    sensor_rate: float,
) -> tuple[StateEstimator, list[Connection]]:
    """The node and its connections.

    Args:
        scene: The system with what the task adds; the model of the filter.
        task: Gives the rate and the limits of commands.
        settings: Of the environment.
        sensing: Delay from the sensor.
        actuation: Expected delay of the soonest command to the world [s].
        sensor_rate: Measurements per second [Hz].

    Raises:
        SettingsError: The filter cannot be made for this system.
    """
    rate, period = task.control_rate, 1.0 / sensor_rate
    own = filter_settings(scene, task, settings.process_noise)
    low, high = command_range(task.command_limits, scene)
    # Messages are taken in at ticks, so the oldest that is new has waited for up to a period of the agent.
    late = (float(sensing.mean) if sensing.constant else sensing.highest) + period
    try:
        node = StateEstimator(
            scene,
            rate,
            own.noise_density,
            own.noise_sd,
            ahead=actuation + mean_further_delay(scene) if settings.estimator == "predicted" else None,
            actuation_delay=actuation,
            measurement_period=period,
            latest=float(sensing.mean) + period,
            start_sd=own.start_sd,
            command_limits=tuple(zip(low.tolist(), high.tolist(), strict=True)),
            idle=tuple(task.idle(scene).tolist()),
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
