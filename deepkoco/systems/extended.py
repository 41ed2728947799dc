"""A system extended by effects, itself a system."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.old_names import moved_names
from deepkoco.systems.added_loads import SumOverJoints, own_values
from deepkoco.systems.channel_delay import channel_delays, latest, sums
from deepkoco.systems.dry_friction import DryFriction, Levels
from deepkoco.systems.effects import EFFECTS, PlacedEffect, SensorSite, effects_of
from deepkoco.systems.effects.effect import steady_level
from deepkoco.systems.joint import JointSystem, TorqueLaw
from deepkoco.systems.joint_memory import JointMemory, Remembering
from deepkoco.systems.joint_state import JointState
from deepkoco.systems.motion import Acceleration, CommandTiming, InverseInertia, Motion, Timing
from deepkoco.systems.named_joints import COMMON
from deepkoco.systems.parameter import ParameterError, Parameters
from deepkoco.systems.rollout import EffectLoad, Rollout
from deepkoco.systems.system import System
from deepkoco.systems.wrapped import WrappedSystem

__getattr__ = moved_names(__name__)


class MemoryEffectError(ValueError):
    """An effect that remembers the past is asked for in a simulation that keeps none."""


class ExtendedSystem(WrappedSystem):
    """A base system plus effects; parameters of an effect are named ``effect.parameter``.

    With every effect at its null value it computes what the base computes. Extending a system of one joint
    gives a :class:`ExtendedJoint`.

    Args:
        base: System to extend.
        effects: Names of effects, with the joint or channel where there are several (``coulomb(joint 2)``), in any
            order; they act in the order of the registry.
        values: New nominal values by full name; those not given keep the base's value or are null.

    Raises:
        ParameterError: An effect or a name in ``values`` is unknown, or a value is out of bounds.
    """

    source: Path | None = None  # model.yaml that it was read from

    def __new__(cls, base: System | None = None, *_: Any, **__: Any) -> ExtendedSystem:
        return object.__new__(ExtendedJoint if isinstance(base, JointSystem) else cls)

    def __init__(
        self, base: System, effects: tuple[str, ...] = (), values: Mapping[str, float] | None = None
    ) -> None:
        known = effects_of(base)
        senseless = [n for n in effects if n in EFFECTS and n not in known]
        unknown = [n for n in effects if n not in known and n not in senseless]
        if unknown:
            raise ParameterError(f"unknown effect {', '.join(unknown)}; known: {', '.join(known)}")
        super().__init__(base)
        self.effects: tuple[PlacedEffect, ...] = tuple(e for name, e in known.items() if name in effects)
        declared = list(base.parameters)
        for placed in self.effects:
            declared += [replace(p, name=f"{placed.name}.{p.name}") for p in placed.parameters(base)]
        self.parameters = tuple(declared)
        if values:
            for name in values:
                self.parameter(name)
            self.parameters = tuple(
                replace(p, value=float(values[p.name])) if p.name in values else p for p in declared
            )

    def accelerations(self, parameters: Parameters, lanes: Mapping[str, slice] | None = None) -> Acceleration:
        """As the base's, with the loads of the effects.

        Args:
            parameters: Named values.
            lanes: Effect -> the part of the last axis on which it is not at its null value; elsewhere it is
                not computed. None computes every effect everywhere.
        """
        law = self.base.accelerations(self._body(parameters))
        return self._loaded(law, self._at("load"), parameters, lanes)

    def free_accelerations(
        self, parameters: Parameters, lanes: Mapping[str, slice] | None = None
    ) -> Acceleration:
        """As :meth:`accelerations`, without any dry friction."""
        law = self.base.free_accelerations(self._body(parameters))
        free = [placed for placed in self._at("load") if not placed.effect.dry]
        return self._loaded(law, free, parameters, lanes)

    def dry_friction_levels(
        self, parameters: Parameters, lanes: Mapping[str, slice] | None = None
    ) -> DryFriction:
        """Levels of the base's dry friction and of the effects'; ``lanes`` as for :meth:`accelerations`."""
        base = self.base.dry_friction_levels(self._body(parameters))
        dry = [placed for placed in self._at("load") if placed.effect.dry]
        if not dry:
            return base
        joints = sorted({*base.joints, *(placed.index for placed in dry)})
        steady = list(base.steady)
        for placed in (p for p in dry if p.effect.steady):
            # At null values its level is 0, so it need not be cut to its lanes.
            level = steady_level(placed.effect, own_values(placed.name, parameters))
            given = steady[placed.index]
            steady[placed.index] = level if given is None else given + level
        moving = [placed for placed in dry if not placed.effect.steady]
        if not moving:
            return replace(base, steady=tuple(steady), joints=tuple(joints))
        levels = SumOverJoints(self.base, self._body(parameters), parameters, moving, lanes, levels=True)

        def varying(motion: Motion, given: Levels) -> Levels:
            return levels(motion, given if base.varying is None else base.varying(motion, given))

        return replace(base, steady=tuple(steady), joints=tuple(joints), varying=varying)

    def dry_friction_limits(self, parameters: Parameters) -> Levels:
        joints = range(self.joints)
        zero = torch.zeros((), dtype=torch.float64)
        still = Motion((zero,) * self.joints, (zero,) * self.joints, (zero,) * len(self.commands))
        levels = self.dry_friction_levels(parameters).levels(still)
        return tuple(None if (level := levels[j]) is None else level.clamp_min(0.0) for j in joints)

    def joint_memory(self, parameters: Parameters) -> JointMemory:
        """What effects remember of the ways of the joints; empty where none does."""
        parts = [
            Remembering(memory, placed.effect.apply, placed.index, own_values(placed.name, parameters))
            for placed in self._at("memory")
            if (memory := placed.effect.memory) is not None
        ]
        return JointMemory(parts)

    def rollout(self, parameters: Parameters) -> Rollout | None:
        base = self.base.rollout(self._body(parameters))
        # Steady dry friction is given with its levels.
        loads = [placed for placed in self._at("load") if not placed.effect.steady]
        if base is None or self._at("memory") or not all(base.knows(placed.effect.name) for placed in loads):
            return None
        return base.with_loads(
            [
                EffectLoad(
                    placed.effect.name,
                    placed.joint(self),
                    placed.source(self),
                    tuple(p.name for p in placed.parameters(self.base)),
                    tuple(
                        torch.as_tensor(parameters[f"{placed.name}.{p.name}"], dtype=torch.float64)
                        for p in placed.parameters(self.base)
                    ),
                )
                for placed in loads
            ]
        )

    def inverse_inertia(self, parameters: Parameters) -> InverseInertia:
        return self.base.inverse_inertia(self._body(parameters))

    def _loaded(
        self,
        law: Acceleration,
        effects: Sequence[PlacedEffect],
        parameters: Parameters,
        lanes: Mapping[str, slice] | None,
    ) -> Acceleration:
        """Equations of motion with the loads of some effects."""
        if not effects:
            return law
        loads = SumOverJoints(self.base, self._body(parameters), parameters, effects, lanes)

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            given = (None,) * self.joints if motion.loads is None else motion.loads
            return law(motion._replace(loads=loads(motion, given)))

        return acceleration

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        for placed in self._at("memory"):
            if not self._at_null(placed, parameters):
                raise MemoryEffectError(
                    f"{placed.name} remembers the way of its joint: it acts along a log and in an environment, and "
                    "has no derivative at a single state"
                )
        parts = state.unbind(-1)
        speeds = parts[self.joints :]
        efforts = (effort,) if len(self.commands) == 1 else effort.unbind(-1)
        motion = Motion(parts[: self.joints], speeds, efforts)
        accelerations = self.accelerations(parameters)(motion)
        return torch.stack(torch.broadcast_tensors(*speeds, *accelerations), -1)

    def actuate(self, command: Tensor, parameters: Parameters) -> Tensor:
        effort = self.base.actuate(command, parameters)
        acting = [p for p in self.effects if p.effect.place in ("command", "series")]
        for placed in acting:
            if placed.effect.place == "series":
                if self._at_null(placed, parameters):
                    continue
                raise MemoryEffectError(
                    f"{placed.name} remembers earlier commands: it acts along a log (diagnosis, identification) and "
                    "cannot be simulated one command at a time"
                )
            own = own_values(placed.name, parameters)
            if len(self.commands) == 1:
                effort = placed.effect.apply(effort, own)
            else:
                parts = [
                    placed.effect.apply(part, own) if placed.acts_on(k, self) else part
                    for k, part in enumerate(effort.unbind(-1))
                ]
                effort = torch.stack(torch.broadcast_tensors(*parts), -1)
        return effort

    def shape_command(self, index: int, value: Tensor, t: Tensor, parameters: Parameters) -> Tensor:
        effort = self.base.shape_command(index, value, t, parameters)
        for placed in self.effects:
            if placed.effect.place not in ("command", "series") or not placed.acts_on(index, self):
                continue
            own = own_values(placed.name, parameters)
            if placed.effect.place == "series":
                if not self._at_null(placed, parameters):
                    effort = placed.effect.apply(effort, t, own)
            else:
                effort = placed.effect.apply(effort, own)
        return effort

    def timing(self, parameters: Parameters) -> Timing:
        zero = torch.zeros((), dtype=torch.float64)
        base = self.base.timing(parameters)
        sensing = base.sensing_delay + parameters.get("sensing_delay.delay", zero)
        names = [self.timing_at("actuation_delay", k) for k in range(len(self.commands))]
        delays = [parameters.get(f"{name}.delay", zero) for name in names]
        names = [self.timing_at("lag", k) for k in range(len(self.commands))]
        lags = [parameters.get(f"{name}.time_constant", zero) for name in names]
        if any(not torch.equal(x, y) for each in (delays, lags) for x, y in pairwise(each)):
            raise MemoryEffectError(f"the commands of {self.name} have delays or lags of their own")
        delay = parameters.get(f"actuation_delay({COMMON}).delay", zero) + delays[0]
        lag = parameters.get(f"lag({COMMON}).time_constant", zero) + lags[0]
        return Timing(base.actuation_delay + delay, sensing, base.lag + lag)

    def command_lags(self, parameters: Parameters) -> Tensor:
        # What `timing` adds to the lag of the base comes from effects and is the same for all commands.
        added = self.timing(parameters).lag - self.base.timing(parameters).lag
        return self.base.command_lags(parameters) + (
            added if len(self.commands) == 1 else added.unsqueeze(-1)
        )

    def further_delays(self, parameters: Parameters) -> tuple[Tensor, ...] | None:
        return self.base.further_delays(parameters)

    def command_timing(self, index: int, parameters: Parameters) -> CommandTiming:
        base = self.base.command_timing(index, parameters)
        zero = torch.zeros((), dtype=torch.float64)
        delay = base.delay + parameters.get("sensing_delay.delay", zero)
        delay = delay - parameters.get("stamp_lead.lead", zero)
        # The state along a log is the one that the latest channel shows, and the base counts its own.
        delay = delay + (
            latest(self.channel_delays(parameters)) - latest(self.base.channel_delays(parameters))
        )
        delay = delay + parameters.get(f"{self.timing_at('actuation_delay', index)}.delay", zero)
        names = [self.timing_at("lag", index)]
        if index < len(self.actuator_joints):
            delay = delay + parameters.get(f"actuation_delay({COMMON}).delay", zero)
            names.append(f"lag({COMMON})")
        lags = [parameters[f"{n}.time_constant"] for n in names if f"{n}.time_constant" in parameters]
        skew = base.skew + parameters.get("clock_skew.rate", zero)
        return CommandTiming(delay, (*base.lag, *lags), skew)

    def sensor_filter(self, parameters: Parameters) -> Tensor:
        return self.base.sensor_filter(parameters) + parameters.get(
            "low_pass.time_constant", torch.zeros((), dtype=torch.float64)
        )

    def channel_delays(self, parameters: Parameters) -> dict[int, Tensor]:
        speeds = [c for joint in range(self.joints) for c in self._channels_of(joint)[1]]
        return sums(self.base.channel_delays(parameters), channel_delays(self.effects, parameters, speeds))

    def output_play(self, parameters: Parameters) -> Levels:
        base, own = (
            self.base.output_play(parameters),
            (self.at_joint("gear_play", j) for j in range(self.joints)),
        )
        found = [parameters.get(f"{name}.width") for name in own]
        return tuple(b if w is None else w if b is None else b + w for b, w in zip(base, found, strict=True))

    def measure(self, state: Tensor, parameters: Parameters) -> Tensor:
        if any(width is not None and bool((width != 0.0).any()) for width in self.output_play(parameters)):
            raise MemoryEffectError(
                "gear_play remembers the way of its joint: it acts along a log and in an environment, and a single "
                "state does not say what its sensors show"
            )
        return self._sensed(self.base.measure(state, parameters), None, parameters)

    def measure_shown(self, shown: Tensor, parameters: Parameters) -> Tensor:
        return self._sensed(self.base.measure_shown(shown, parameters), None, parameters)

    def measure_at(self, state: Tensor, time: Tensor, parameters: Parameters) -> Tensor:
        return self._sensed(self.base.measure_at(state, time, parameters), time, parameters)

    def _sensed(self, measurement: Tensor, time: Tensor | None, parameters: Parameters) -> Tensor:
        for placed in self._at("sensor"):
            if placed.effect.site == "channel":
                site = SensorSite((placed.index,), (), time)
            else:
                joint, source = placed.joint(self.base), placed.source(self.base)
                site = SensorSite(*self._channels_of(joint), time, self._channels_of(source))
            measurement = placed.effect.apply(measurement, site, own_values(placed.name, parameters))
        return measurement

    def _channels_of(self, joint: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Channels of a joint's position, and those of its speed."""
        shown = list(enumerate(self.measured_states))
        own = [tuple(c for c, s in shown if s == k) for k in (joint, joint + self.joints)]
        return own[0], own[1]

    def _at_null(self, placed: PlacedEffect, parameters: Parameters) -> bool:
        own = own_values(placed.name, parameters)
        return all(bool((own[p.name] == p.value).all()) for p in placed.parameters(self.base))

    def _at(self, where: str) -> list[PlacedEffect]:
        return [placed for placed in self.effects if placed.effect.place == where]

    def _body(self, parameters: Parameters) -> Parameters:
        for placed in self._at("body"):
            own = own_values(placed.name, parameters)
            parameters = placed.effect.apply(self.base, placed.index, parameters, own)
        return parameters


class ExtendedJoint(ExtendedSystem, JointSystem):
    """An extended system of one joint, which is a system of one joint itself."""

    base: JointSystem

    def __init__(
        self, base: JointSystem, effects: tuple[str, ...] = (), values: Mapping[str, float] | None = None
    ) -> None:
        super().__init__(base, effects, values)
        self.command, self.upright = base.command, base.upright

    def inertia(self, parameters: Parameters) -> Tensor:
        return self.base.inertia(self._body(parameters))

    def torque_law(self, parameters: Parameters) -> TorqueLaw:
        law = self.base.torque_law(self._body(parameters))
        loads = [
            (placed.effect, placed.effect.acting(own_values(placed.name, parameters)))
            for placed in self._at("load")
        ]

        (smooth,) = self.smoothing_speeds

        def torque(theta: Tensor, omega: Tensor, effort: Tensor, smoothing: Tensor | None) -> Tensor:
            total = law(theta, omega, effort, smoothing)
            state = JointState(theta, omega, effort, None, smooth if smoothing is None else smoothing)
            for effect, own in loads:
                total = total + effect.apply(state, own)
            return total

        return torque

    def draw_body(self, image: np.ndarray, angle_from_upright: float) -> None:
        self.base.draw_body(image, angle_from_upright)
