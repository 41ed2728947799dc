"""Settings of an environment on the delay graph, checked before anything is built."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from deepkoco.envs.tasks import TASKS, GoalTask, Task, TaskDeclarationError, UnknownTaskError, load_task
from deepkoco.envs.world_rate import slowest_world_rate
from deepkoco.graph.delay import Delay, DelayError, make_delay
from deepkoco.systems import SYSTEMS, ExtendedSystem, System, any_system
from deepkoco.systems.channel_delay import OF_SPEEDS
from deepkoco.systems.parameter import Parameters
from deepkoco.systems.stick_slip import Joints, StickSlip

INTEGRATORS = ("rk4", "semi_implicit_euler")
ACTION_UNITS = ("normalized", "physical")
DELAYS = ("actuation_delay", "sensing_delay")
ESTIMATORS = ("none", "filtered", "predicted")


class SettingsError(ValueError):
    """An argument of an environment is wrong."""


@dataclass(frozen=True)
class EnvironmentSettings:
    """What an environment on the delay graph simulates.

    Attributes:
        system: The system, or what `deepkoco.load_system` takes; None takes that of the model.
        task: A task, or what `deepkoco.envs.tasks.load_task` takes; None: the swing-up that bears the system's name, or
            else a `GoalTask`.
        model: Path of a model.yaml, or a system, to simulate in place of the nominal system.
        actuation_delay: Delay from the agent to the actuator [s]: a number, a delay law or its
            description; the model's own delay adds to it.
        sensing_delay: Delay from the sensor to the agent [s], likewise.
        world_rate: Ticks of the simulated physics per second [Hz], the control rate or more; None chooses the slowest
            at which the equations can be integrated.
        integrator: ``rk4``, or ``semi_implicit_euler`` for Gymnasium's scheme.
        randomize: Parameter or delay name -> (low, high): drawn uniformly for every episode and
            environment. A range replaces the nominal value.
        noise: Whether measurements carry the noise that the system's channels declare.
        action_history: How many past actions are appended to the observation, newest first.
        action_units: ``normalized``: actions in [-1, 1]; ``physical``: in the commands' units.
        observation_history: How many past observations are appended before the actions, newest first.
        estimator: What the agent sees in the place of the newest measurement: ``filtered``, what an unscented filter
            makes of all that have come, at the time of the newest; ``predicted``, at the time at which the next command
            will act, by the mean actuation delay. The model of the filter has the nominal parameters.
        process_noise: Of that filter: standard deviation of the white acceleration of each joint, times the square root
            of a second [rad/s^1.5, m/s^1.5].
    """

    system: str | Path | System | type[System] | None = None
    task: str | Task | type[Task] | Mapping[str, float] | None = None
    model: str | Path | System | None = None
    actuation_delay: Delay | float | Mapping[str, Any] = 0.0
    sensing_delay: Delay | float | Mapping[str, Any] = 0.0
    world_rate: float | None = 100.0
    integrator: str = "rk4"
    randomize: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    noise: bool = False
    action_history: int = 0
    action_units: str = "normalized"
    observation_history: int = 0
    estimator: str = "none"
    process_noise: float = 1.0

    def __post_init__(self) -> None:
        for name, value, choices in (
            ("integrator", self.integrator, INTEGRATORS),
            ("action_units", self.action_units, ACTION_UNITS),
            ("estimator", self.estimator, ESTIMATORS),
        ):
            if value not in choices:
                raise SettingsError(f'{name} "{value}" is none of {", ".join(choices)}')
        for name in ("action_history", "observation_history"):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name} = {getattr(self, name)}; give 0 or more")
        if not (self.process_noise > 0 and math.isfinite(self.process_noise)):
            raise SettingsError(f"process_noise = {self.process_noise}; give a positive number")
        if self.system is None and self.model is None:
            raise SettingsError("system is not given; give a name, my_robot.py:CLASS, arm.xml or model.yaml")
        system, task = self.make_system(), self.find_task()
        rate = task.control_rate
        if self.world_rate is None:
            object.__setattr__(self, "world_rate", slowest_world_rate(system, rate, task.speed_limit))
        assert self.world_rate is not None
        if not (self.world_rate > 0 and math.isfinite(self.world_rate)):
            raise SettingsError(f"world_rate = {self.world_rate} Hz; give a positive number")
        if self.world_rate < rate:
            raise SettingsError(
                f"world_rate = {self.world_rate:g} Hz is below the control rate of {system.name}; give "
                f"{rate:g} Hz or more"
            )
        for name in DELAYS:
            try:
                make_delay(getattr(self, name))
            except DelayError as error:
                raise SettingsError(f"{name}: {error}") from error
        self._check_ranges()

    @property
    def ticks_per_second(self) -> float:
        """Ticks of the simulated physics per second [Hz], as given or as chosen."""
        assert self.world_rate is not None
        return self.world_rate

    def make_system(self) -> System:
        """The system to simulate, with its nominal parameters.

        Raises:
            SettingsError: The model belongs to another system, or has an effect that acts along a log only.
        """
        wanted = self.model if self.system is None else self.system
        system = any_system(wanted if self.model is None else self.model)  # type: ignore[arg-type]
        if self.model is not None and self.system is not None:
            # A name is compared as it is: its system need not be made for it.
            known = isinstance(wanted, str) and wanted in SYSTEMS
            name = wanted if known else any_system(wanted).name  # type: ignore[arg-type]
            if system.name != name:
                raise SettingsError(f"the model is of {system.name}, the environment of {name}")
        _check_steps(system, self.integrator)
        return system

    def find_task(self) -> Task:
        """The task, for this system.

        Raises:
            SettingsError: There is none of that name, or it is of another system.
        """
        system = self.make_system()
        usual = TASKS.get(system.name) if self.task is None else None
        try:
            task = usual or (GoalTask() if self.task is None else load_task(self.task))
        except UnknownTaskError as error:
            raise SettingsError(f"task: {error}") from error
        if getattr(task, "system", None) not in (None, system.name):
            raise SettingsError(f'task "{self.task}" is one of {task.system}, not of {system.name}')
        try:
            return task.on(task.scene(system))
        except TaskDeclarationError as error:
            raise SettingsError(f"task: {error}") from error

    def _check_ranges(self) -> None:
        system = self.make_system()
        bounds = {p.name: (p.low, p.high, p.unit) for p in system.parameters}
        bounds |= {name: (0.0, math.inf, "s") for name in DELAYS}
        for name, span in self.randomize.items():
            if name not in bounds:
                raise SettingsError(f'randomize: "{name}" is none of {", ".join(bounds)}')
            check_range(name, span, *bounds[name])
        if isinstance(system, ExtendedSystem):
            for own, effect in zip(DELAYS, ("actuation_delay.delay", "sensing_delay.delay"), strict=True):
                if own in self.randomize and effect in bounds:
                    raise SettingsError(f"randomize: {own} is {effect} of the model; randomize that")


def check_range(name: str, span: Any, low: float, high: float, unit: str) -> None:
    """Check a range of ``randomize``.

    Raises:
        SettingsError: ``span`` is no (first, last) with low <= first <= last <= high.
    """
    try:
        first, last = (float(end) for end in span)
        fits = low <= first <= last <= high and math.isfinite(last - first)
    except (TypeError, ValueError):
        fits = False
    if not fits:
        raise SettingsError(f"randomize: {name} = {span!r} {unit}; give (low, high) inside [{low}, {high}]")


def _check_steps(system: System, integrator: str) -> None:
    """Refuse a model that cannot be simulated step by step, before episodes begin."""
    parameters = system.default_parameters()
    if left_out := _of_sensors_alone(system, parameters):
        warnings.warn(
            f"the environment leaves out {' and '.join(left_out)} of the model, which act on what sensors show along a "
            "log; DelayWrapper delays terms of an observation: sensing_delay={TERM: SECONDS}",
            stacklevel=2,
        )
    state = torch.zeros(len(system.state_names), dtype=torch.float64)
    command = system.effort_of(torch.zeros(len(system.commands), dtype=torch.float64))
    try:
        effort = system.actuate(command, parameters)
        if integrator == "rk4" and any(StickSlip.sizes(system)):
            joints = system.joints
            parts = state.unbind(-1)
            efforts = (effort,) if effort.ndim == 0 else effort.unbind(-1)
            law = StickSlip(system, parameters)
            rest = (torch.zeros((), dtype=torch.float64),) * len(law.rubbing)
            angles, speeds = parts[:joints], parts[joints : 2 * joints]
            memory = law.first_memory(angles, speeds, efforts)
            law.tick(Joints(angles, speeds, rest, memory), efforts, 1e-3)
        if integrator != "rk4" or len(state) > 2 * system.joints or not system.joint_memory(parameters).parts:
            system.derivative(state, effort, parameters)
        system.measure_shown(state, parameters)
    except ValueError as error:
        raise SettingsError(
            f"the model cannot be simulated step by step: {error}; leave that effect out of the model"
        ) from error


def _of_sensors_alone(system: System, parameters: Parameters) -> list[str]:
    """Name the filter of the sensors and the late channels that a model has."""
    of_speeds = f"{OF_SPEEDS}.delay"
    common = float(parameters.get(of_speeds, 0.0)) > 0.0
    alone = {name: value for name, value in parameters.items() if name != of_speeds}
    late = system.channel_delays(alone).items()
    found = [f"channel_delay({system.measurements[c].name})" for c, delay in late if float(delay) > 0.0]
    found = [*found, *([OF_SPEEDS] if common else [])]
    return [*found, *(["low_pass"] if float(system.sensor_filter(parameters)) > 0.0 else [])]
