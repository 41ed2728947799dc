"""A system that stands on another one and passes on what that declares."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from copy import copy
from typing import Self

import numpy as np
from torch import Tensor

from deepkoco.systems.channel import Channel
from deepkoco.systems.drawn import Outline
from deepkoco.systems.drives import Drive
from deepkoco.systems.dry_friction import DryFriction, Levels
from deepkoco.systems.engine_names import MUJOCO
from deepkoco.systems.joint_memory import JointMemory
from deepkoco.systems.motion import Acceleration, CommandTiming, Delivery, InverseInertia, PayloadWay, Timing
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.rollout import RolledEffect, Rollout
from deepkoco.systems.system import System


class WrappedSystem(System):
    """A system of which all that a subclass does not change is the base's.

    Args:
        base: The system that it stands on.
    """

    wraps = True

    def __init__(self, base: System) -> None:
        self.base = base
        self.name, self.origin, self.notes = base.name, base.origin, base.notes
        self.joints, self.parameters, self.measurements = base.joints, base.parameters, base.measurements
        self.state_names, self.state_units = base.state_names, base.state_units
        self.dry_friction = base.dry_friction
        self.payload_sites, self.tip = base.payload_sites, base.tip
        self.force_sites, self.push_places = base.force_sites, base.push_places

    def unseen_joints(self, channels: Collection[str]) -> list[str]:
        return self.base.unseen_joints(channels)

    def way_to_hold(self, channels: Collection[str]) -> str:
        return self.base.way_to_hold(channels)

    @property
    def commands(self) -> tuple[Channel, ...]:
        return self.base.commands

    @property
    def command_joints(self) -> tuple[int, ...]:
        return self.base.command_joints

    @property
    def actuator_joints(self) -> tuple[int, ...]:
        return self.base.actuator_joints

    @property
    def measured_states(self) -> tuple[int, ...]:
        return self.base.measured_states

    @property
    def load_scale(self) -> float:
        return self.base.load_scale

    @property
    def load_scales(self) -> tuple[float, ...]:
        return self.base.load_scales

    @property
    def drives(self) -> tuple[Drive, ...]:
        return self.base.drives

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.base.joint_names

    @property
    def own_joints(self) -> int:
        return self.base.own_joints

    @property
    def coupled_joints(self) -> tuple[tuple[int, int], ...]:
        return self.base.coupled_joints

    @property
    def shown_pairs(self) -> tuple[tuple[int, int], ...]:
        return self.base.shown_pairs

    def at_joint(self, name: str, joint: int) -> str:
        return self.base.at_joint(name, joint)

    def at_command(self, name: str, command: int) -> str:
        return self.base.at_command(name, command)

    def timing_at(self, name: str, command: int) -> str:
        return self.base.timing_at(name, command)

    @property
    def loaded_joints(self) -> tuple[int, ...]:
        return self.base.loaded_joints

    @property
    def takes_payload(self) -> bool:
        return self.base.takes_payload

    @property
    def has_equations(self) -> bool:
        return self.base.has_equations

    @property
    def has_accelerations(self) -> bool:
        return self.base.has_accelerations

    @property
    def resizable(self) -> bool:
        return self.base.resizable

    @property
    def tilt_parameters(self) -> tuple[Parameter, ...]:
        return self.base.tilt_parameters

    @property
    def delivered_scales(self) -> tuple[tuple[float, str], ...]:
        return self.base.delivered_scales

    @property
    def drive_parameters(self) -> tuple[tuple[str, ...], ...]:
        return self.base.drive_parameters

    @property
    def smoothing_speeds(self) -> tuple[float, ...]:
        return self.base.smoothing_speeds

    @property
    def longest_step(self) -> float:
        return self.base.longest_step

    def effort_of(self, commands: Tensor) -> Tensor:
        return self.base.effort_of(commands)

    def ideal_measurement(self, state: Tensor) -> Tensor:
        return self.base.ideal_measurement(state)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return self.base.with_payload(mass, parameters)

    def with_payload_at(
        self, site: str, mass: Tensor, parameters: Parameters, along: Tensor | None = None
    ) -> Parameters:
        if along is None:
            return self.base.with_payload_at(site, mass, parameters)
        return self.base.with_payload_at(site, mass, parameters, along)

    def payload_way(self, site: str) -> PayloadWay | None:
        return self.base.payload_way(site)

    def force_parameters(self, site: str) -> tuple[Parameter, ...]:
        return self.base.force_parameters(site)

    def with_force_at(self, site: str, force: Parameters, parameters: Parameters) -> Parameters:
        return self.base.with_force_at(site, force, parameters)

    def loads_of_push(self, place: int, point: Tensor, angles: Sequence[Tensor]) -> Tensor:
        return self.base.loads_of_push(place, point, angles)

    def with_length(self, factor: Tensor, joint: int, parameters: Parameters) -> Parameters:
        return self.base.with_length(factor, joint, parameters)

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        self.base.draw_on(image, measurement, command)

    def accelerations(self, parameters: Parameters) -> Acceleration:
        return self.base.accelerations(parameters)

    def free_accelerations(self, parameters: Parameters) -> Acceleration:
        return self.base.free_accelerations(parameters)

    def dry_friction_limits(self, parameters: Parameters) -> Levels:
        return self.base.dry_friction_limits(parameters)

    def dry_friction_levels(self, parameters: Parameters) -> DryFriction:
        return self.base.dry_friction_levels(parameters)

    @property
    def bodies(self) -> dict[str, dict[str, float]]:
        return self.base.bodies

    @property
    def engines(self) -> tuple[str, ...]:
        return self.base.engines

    @property
    def engine(self) -> str | None:
        return self.base.engine

    @property
    def engine_step(self) -> float | None:
        return self.base.engine_step

    @property
    def own_step(self) -> float | None:
        return self.base.own_step

    def with_engine(self, name: str | None = MUJOCO, step: float | None = None) -> Self | None:
        base = self.base.with_engine(name, step)
        if base is None:
            return None
        wrapped = copy(self)
        wrapped.base, wrapped.notes = base, base.notes
        return wrapped

    def joint_memory(self, parameters: Parameters) -> JointMemory:
        return self.base.joint_memory(parameters)

    def inverse_inertia(self, parameters: Parameters) -> InverseInertia:
        return self.base.inverse_inertia(parameters)

    def output_play(self, parameters: Parameters) -> Levels:
        return self.base.output_play(parameters)

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        return self.base.derivative(state, effort, parameters)

    def actuate(self, command: Tensor, parameters: Parameters) -> Tensor:
        return self.base.actuate(command, parameters)

    def timing(self, parameters: Parameters) -> Timing:
        return self.base.timing(parameters)

    def delivery(self, parameters: Parameters) -> Delivery | None:
        return self.base.delivery(parameters)

    def shape_command(self, index: int, value: Tensor, t: Tensor, parameters: Parameters) -> Tensor:
        return self.base.shape_command(index, value, t, parameters)

    def command_timing(self, index: int, parameters: Parameters) -> CommandTiming:
        return self.base.command_timing(index, parameters)

    def command_lags(self, parameters: Parameters) -> Tensor:
        return self.base.command_lags(parameters)

    def further_delays(self, parameters: Parameters) -> tuple[Tensor, ...] | None:
        return self.base.further_delays(parameters)

    def sensor_filter(self, parameters: Parameters) -> Tensor:
        return self.base.sensor_filter(parameters)

    def channel_delays(self, parameters: Parameters) -> dict[int, Tensor]:
        return self.base.channel_delays(parameters)

    def measure(self, state: Tensor, parameters: Parameters) -> Tensor:
        return self.base.measure(state, parameters)

    def measure_shown(self, shown: Tensor, parameters: Parameters) -> Tensor:
        return self.base.measure_shown(shown, parameters)

    def measure_at(self, state: Tensor, time: Tensor, parameters: Parameters) -> Tensor:
        return self.base.measure_at(state, time, parameters)

    def outline(self, angles: np.ndarray) -> Outline | None:
        return self.base.outline(angles)

    def rollout(self, parameters: Parameters) -> Rollout | None:
        return self.base.rollout(parameters)

    def rolls(self, effect: RolledEffect) -> bool:
        return self.base.rolls(effect)
