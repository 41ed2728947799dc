"""A system extended by effects, itself a system, and its file model.yaml."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import yaml
from torch import Tensor

from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems.dry_friction import DryFriction, Levels
from deepkoco.systems.effects import EFFECTS, JointState, PlacedEffect, SensorSite, effects_of
from deepkoco.systems.effects.effect import COMMON, JointLanes, in_lanes, steady_level
from deepkoco.systems.joint import JointSystem, TorqueLaw
from deepkoco.systems.joint_memory import JointMemory, Remembering
from deepkoco.systems.origins import find_stored, origin_of, stored_origin
from deepkoco.systems.registry import SYSTEMS, UnknownSystemError, make_system
from deepkoco.systems.rollout import EffectLoad, Rollout
from deepkoco.systems.system import (
    Acceleration,
    Channel,
    CommandTiming,
    InverseInertia,
    Motion,
    Parameter,
    ParameterError,
    Parameters,
    PayloadWay,
    System,
    Timing,
)
from deepkoco.yaml_file import YamlFileError, read_yaml

MODEL_VERSION = 1


class ModelFileError(ValueError):
    """A model.yaml cannot be read."""


class MemoryEffectError(ValueError):
    """An effect that remembers the past is asked for in a simulation that keeps none."""


class ExtendedSystem(System):
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
    wraps = True

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
        self.base = base
        self.name, self.origin, self.notes = base.name, base.origin, base.notes
        self.joints = base.joints
        self.state_names, self.state_units = base.state_names, base.state_units
        self.dry_friction = base.dry_friction
        self.payload_sites, self.tip = base.payload_sites, base.tip
        self.force_sites = base.force_sites
        self.effects: tuple[PlacedEffect, ...] = tuple(e for name, e in known.items() if name in effects)
        declared = list(base.parameters)
        for placed in self.effects:
            declared += [replace(p, name=f"{placed.name}.{p.name}") for p in placed.parameters(base)]
        self.parameters = tuple(declared)
        self.measurements = base.measurements
        if values:
            for name in values:
                self.parameter(name)
            self.parameters = tuple(
                replace(p, value=float(values[p.name])) if p.name in values else p for p in declared
            )

    @property
    def commands(self) -> tuple[Channel, ...]:
        return self.base.commands

    @property
    def command_joints(self) -> tuple[int, ...]:
        return self.base.command_joints

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
    def joint_names(self) -> tuple[str, ...]:
        return self.base.joint_names

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
    def smoothing_speeds(self) -> tuple[float, ...]:
        return self.base.smoothing_speeds

    @property
    def longest_step(self) -> float:
        return self.base.longest_step

    def effort_of(self, commands: Tensor) -> Tensor:
        return self.base.effort_of(commands)

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
            level = steady_level(placed.effect, _own(placed.name, parameters))
            given = steady[placed.index]
            steady[placed.index] = level if given is None else given + level
        moving = [placed for placed in dry if not placed.effect.steady]
        if not moving:
            return replace(base, steady=tuple(steady), joints=tuple(joints))
        levels = _SumOverJoints(self, parameters, moving, lanes, levels=True)

        def varying(motion: Motion, given: Levels) -> Levels:
            return levels(motion, given if base.varying is None else base.varying(motion, given))

        return DryFriction(tuple(steady), tuple(joints), varying)

    def dry_friction_limits(self, parameters: Parameters) -> Levels:
        joints = range(self.joints)
        zero = torch.zeros((), dtype=torch.float64)
        still = Motion((zero,) * self.joints, (zero,) * self.joints, (zero,) * len(self.commands))
        levels = self.dry_friction_levels(parameters).levels(still)
        return tuple(None if (level := levels[j]) is None else level.clamp_min(0.0) for j in joints)

    def joint_memory(self, parameters: Parameters) -> JointMemory:
        """What effects remember of the ways of the joints; empty where none does."""
        parts = [
            Remembering(placed.effect, placed.index, _own(placed.name, parameters))
            for placed in self._at("memory")
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
        loads = _SumOverJoints(self, parameters, effects, lanes)

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
            own = _own(placed.name, parameters)
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
            own = _own(placed.name, parameters)
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
        names = [self._command_effect("actuation_delay", k) for k in range(len(self.commands))]
        delays = [parameters.get(f"{name}.delay", zero) for name in names]
        names = [self._command_effect("lag", k) for k in range(len(self.commands))]
        lags = [parameters.get(f"{name}.time_constant", zero) for name in names]
        if any(not torch.equal(x, y) for each in (delays, lags) for x, y in pairwise(each)):
            raise MemoryEffectError(f"the commands of {self.name} have delays or lags of their own")
        delay = parameters.get(f"actuation_delay({COMMON}).delay", zero) + delays[0]
        lag = parameters.get(f"lag({COMMON}).time_constant", zero) + lags[0]
        return Timing(base.actuation_delay + delay, sensing, base.lag + lag)

    def command_timing(self, index: int, parameters: Parameters) -> CommandTiming:
        base = self.base.command_timing(index, parameters)
        zero = torch.zeros((), dtype=torch.float64)
        delay = base.delay + parameters.get("sensing_delay.delay", zero)
        delay = delay - parameters.get("stamp_lead.lead", zero)
        delay = delay + parameters.get(f"{self._command_effect('actuation_delay', index)}.delay", zero)
        names = [self._command_effect("lag", index)]
        if index < len(self.command_joints):
            delay = delay + parameters.get(f"actuation_delay({COMMON}).delay", zero)
            names.append(f"lag({COMMON})")
        lags = [parameters[f"{n}.time_constant"] for n in names if f"{n}.time_constant" in parameters]
        skew = base.skew + parameters.get("clock_skew.rate", zero)
        return CommandTiming(delay, (*base.lag, *lags), skew)

    def sensor_filter(self, parameters: Parameters) -> Tensor:
        return self.base.sensor_filter(parameters) + parameters.get(
            "low_pass.time_constant", torch.zeros((), dtype=torch.float64)
        )

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

    def with_length(self, factor: Tensor, joint: int, parameters: Parameters) -> Parameters:
        return self.base.with_length(factor, joint, parameters)

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        self.base.draw_on(image, measurement, command)

    def _sensed(self, measurement: Tensor, time: Tensor | None, parameters: Parameters) -> Tensor:
        for placed in self._at("sensor"):
            if placed.effect.site == "channel":
                site = SensorSite((placed.index,), (), time)
            else:
                shown = list(enumerate(self.measured_states))
                positions = tuple(c for c, s in shown if s == placed.index)
                speeds = tuple(c for c, s in shown if s == placed.index + self.joints)
                site = SensorSite(positions, speeds, time)
            measurement = placed.effect.apply(measurement, site, _own(placed.name, parameters))
        return measurement

    def _at_null(self, placed: PlacedEffect, parameters: Parameters) -> bool:
        own = _own(placed.name, parameters)
        return all(bool((own[p.name] == p.value).all()) for p in placed.parameters(self.base))

    def _command_effect(self, name: str, index: int) -> str:
        return name if self.joints == 1 else self.at_joint(name, self.command_joints[index])

    def _at(self, where: str) -> list[PlacedEffect]:
        return [placed for placed in self.effects if placed.effect.place == where]

    def _body(self, parameters: Parameters) -> Parameters:
        for placed in self._at("body"):
            own = _own(placed.name, parameters)
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
            (placed.effect, placed.effect.acting(_own(placed.name, parameters)))
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


def _own(effect: str, parameters: Parameters) -> dict[str, Tensor]:
    prefix = f"{effect}."
    return {name[len(prefix) :]: value for name, value in parameters.items() if name.startswith(prefix)}


class _Part(NamedTuple):
    """What an effect adds at one joint, and the lanes that it concerns; None for all."""

    apply: Callable[..., Tensor]
    joint: int
    source: int  # joint whose effort it is shown
    values: Parameters
    lanes: slice | None

    @staticmethod
    def of(
        placed: PlacedEffect, system: System, parameters: Parameters, lanes: slice | None, level: bool
    ) -> _Part:
        own = placed.effect.acting(_own(placed.name, parameters))
        if lanes is not None:
            own = {n: in_lanes(v, lanes.start, lanes.stop) for n, v in own.items()}
        apply = placed.effect.level if level else placed.effect.apply
        assert apply is not None
        return _Part(apply, placed.joint(system), placed.source(system), own, lanes)


class _SumOverJoints:
    """Sum of what effects add at each joint: their loads, or the levels of their dry friction.

    Args:
        system: The extended system.
        parameters: Named values.
        effects: Effects at joints.
        lanes: As for :meth:`ExtendedSystem.accelerations`.
        levels: Whether levels of dry friction are summed, not loads.
    """

    def __init__(
        self,
        system: ExtendedSystem,
        parameters: Parameters,
        effects: Sequence[PlacedEffect],
        lanes: Mapping[str, slice] | None,
        levels: bool = False,
    ) -> None:
        self._parts = [
            _Part.of(placed, system, parameters, None if lanes is None else lanes.get(placed.name), levels)
            for placed in effects
        ]
        self._driven = {joint: k for k, joint in enumerate(system.base.command_joints)}
        self._deliver = system.base.delivery(system._body(parameters))
        self._smoothing = system.smoothing_speeds

    def __call__(self, motion: Motion, given: Levels) -> Levels:
        """Add to what is given for each joint; None stands for 0."""
        total = list(given)
        own: set[int] = set()
        states: dict[tuple[int, int], JointState] = {}
        delivered = motion.efforts if self._deliver is None else self._deliver(motion)
        for part in self._parts:
            j = part.joint
            state = states.get((j, part.source))
            if state is None:
                state = states[j, part.source] = self._state(motion, delivered, j, part.source)
            before, lane = total[j], part.lanes
            if lane is None:
                value = part.apply(state, part.values)
                total[j] = value if before is None else before + value
                continue
            if before is None:
                before = torch.zeros_like(state.speed)
            elif j not in own:
                # What the caller gave is not ours to change, and may be one value for all lanes.
                before = before + torch.zeros_like(state.speed)
            own.add(j)
            value = part.apply(JointLanes(state, lane), part.values)
            before.narrow(-1, lane.start, lane.stop - lane.start).add_(value)
            total[j] = before
        return tuple(total)

    def _state(self, motion: Motion, delivered: tuple[Tensor, ...], j: int, source: int) -> JointState:
        k = self._driven.get(source)
        effort = torch.zeros_like(motion.speeds[j]) if k is None else delivered[k]
        smoothing = self._smoothing[j] if motion.smoothing is None else motion.smoothing[j]
        return JointState(motion.angles[j], motion.speeds[j], effort, motion.time, smoothing)


def save_model(path: str | Path, system: System, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a system as model.yaml, atomically.

    Args:
        path: File to write.
        system: Plain or extended system.
        provenance: Where it comes from (log, verdict, version), stored beside it.

    Raises:
        FileExistsError: The file is there already.
        WriteError: The disk is full, or the place cannot be written.
    """
    path = Path(path)
    if path.exists():
        raise FileExistsError(f"{path} exists; choose another name")
    base = system.base if isinstance(system, ExtendedSystem) else system
    effects = [e.name for e in system.effects] if isinstance(system, ExtendedSystem) else []
    learned = [e for e in effects if e.split("(")[0] == "learned"]
    origin = origin_of(base)
    document = {
        "version": MODEL_VERSION,
        "system": base.name,
        **({} if origin is None else {"origin": stored_origin(origin, path.parent)}),
        "effects": effects,
        # Fitted to data, without a mechanism behind it: for readers of the file.
        **({"learned": learned} if learned else {}),
        "parameters": {p.name: {"value": p.value, "unit": p.unit} for p in system.parameters},
        "provenance": dict(provenance or {}),
    }
    write_whole_text(path, yaml.safe_dump(document, sort_keys=False))


def load_model(path: str | Path) -> ExtendedSystem:
    """Read a system from model.yaml.

    The key ``origin`` names the class or file of a system that is not the package's: a relative path is looked for
    from the folder of model.yaml, then from the current folder. A file of Python is imported, so its code runs.

    Raises:
        ModelFileError: The file is missing, is not YAML, or does not describe a known system.
    """
    path = Path(path)
    try:
        document = read_yaml(path)
    except YamlFileError as error:
        raise ModelFileError(str(error)) from error
    if not isinstance(document, dict) or document.get("version") != MODEL_VERSION:
        raise ModelFileError(f"{path}: not a model file of version {MODEL_VERSION}")
    try:
        values = {name: float(entry["value"]) for name, entry in document["parameters"].items()}
        base = _base_of(document, path)
        system = ExtendedSystem(base, tuple(document["effects"]), values)
    except (KeyError, TypeError, AttributeError) as error:
        raise ModelFileError(f"{path}: misses or garbles the entry {error}") from error
    except ValueError as error:
        raise ModelFileError(f"{path}: {error}") from error
    system.source = path
    return system


def _base_of(document: dict[str, Any], path: Path) -> System:
    """The system that a model file extends: by its name, or where the file says that it comes from.

    Raises:
        ModelFileError: The system has another name now.
        UnknownSystemError: It is not found.
    """
    name, origin = document["system"], document.get("origin")
    registered = SYSTEMS.get(name)
    if registered is not None and not registered.__module__.startswith("deepkoco."):
        return make_system(name)
    if origin is None:
        try:
            return make_system(name)
        except UnknownSystemError as error:
            raise UnknownSystemError(
                f"{error}; one of your own: deepkoco.register_system(CLASS) first"
            ) from error
    if not isinstance(origin, str):
        raise TypeError("origin")
    base = find_stored(origin, path.parent)
    if base.name != name:
        raise ModelFileError(
            f"{path}: is a model of {name}, and {origin} is called {base.name} now; give it its name back"
        )
    return base
