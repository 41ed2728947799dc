"""A robot given as MJCF or URDF, as a system: a contact-free tree of hinges and slides."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.drawn import Outline
from deepkoco.systems.drives import AS_A_LOAD
from deepkoco.systems.dry_friction import DryFriction, Levels
from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.engine_names import MUJOCO
from deepkoco.systems.extended import MemoryEffectError
from deepkoco.systems.motion import (
    Acceleration,
    CommandTiming,
    Delivery,
    InverseInertia,
    Motion,
    PayloadWay,
    Timing,
)
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.plain import is_plain
from deepkoco.systems.system import System
from deepkoco.systems.trees.base_tilt import tilt_parameters, turned_gravity
from deepkoco.systems.trees.channels import command_channels, joint_channels, refuse_clashes
from deepkoco.systems.trees.chosen_engine import engine_named, engines_with, noted
from deepkoco.systems.trees.compile_tree import compile_tree
from deepkoco.systems.trees.dynamics import inverse_mass, mass_matrix
from deepkoco.systems.trees.engine import ahead, creeping, softness_in, with_late_speeds
from deepkoco.systems.trees.equations import Numbers, Steadying, actuators_of_joints, equations_of_motion
from deepkoco.systems.trees.fast import TreeArrays
from deepkoco.systems.trees.geometry import geometry_parameters
from deepkoco.systems.trees.held_joints import how_to_hold
from deepkoco.systems.trees.loads import actuator_forces, clipped
from deepkoco.systems.trees.model_file import read_model
from deepkoco.systems.trees.outside_forces import force_name
from deepkoco.systems.trees.parameters import (
    actuator_law,
    control_delay,
    declared_parameters,
    drive_parameters,
    grows_with_mass,
    joint_value,
    payload_name,
    payload_place_name,
    time_constant,
)
from deepkoco.systems.trees.picture import choose_view, draw_robot, lines
from deepkoco.systems.trees.place_parameters import force_parameters, payload_ways
from deepkoco.systems.trees.places import tip_place
from deepkoco.systems.trees.pushes import loads_of_push, push_places
from deepkoco.systems.trees.rollout import TreeRollout, is_known
from deepkoco.systems.trees.scalars import Triple, mul, total
from deepkoco.systems.trees.scales import command_range, delivered, load_scales, motion_loads
from deepkoco.systems.trees.settings import TreeSettings
from deepkoco.systems.trees.stiffness import least_inertias, longest_step, refuse_redundant
from deepkoco.systems.trees.tree import Tree, TreeError
from deepkoco.systems.trees.visible import visible_parameters


class TreeSystem(System):
    r"""M(q) q'' + c(q, q') = gear f(u) - D q' - K (q - q_s) - F_c sign(q') + load, for a tree of hinges and slides.

    M and c follow from the masses, centres of mass and inertias of the bodies. f is the force of the actuators:
    clip((g0 + g1 l + g2 l') u + b0 + b1 l + b2 l') with l = gear q, u clipped to its range and behind a first-order
    filter where the actuator has one. `accelerations` are exactly these; simulations (`derivative`,
    `free_accelerations`) slow down motions that are too fast for any log, see :mod:`deepkoco.systems.trees.stiffness`.
    Contacts and limits of joints are not simulated; :attr:`notes` says so where the
    model has any.

    Args:
        tree: Description of the robot.
        origin: File that it was read from.
        settings: Values, priors, noise and servos that differ from the description's.

    Attributes:
        tree: The description.
        origin: Text by which the robot is found again; None if it was made in Python.
        held: Joints of the file that are held; see :func:`.hold_joints`.
        payload_sites: Names of the places at which a payload can be fixed; see `with_payload_at`.
        tip: The place of `with_payload`.
    """

    tip: str

    def __init__(self, tree: Tree, origin: str | None = None, settings: TreeSettings | None = None) -> None:
        settings = TreeSettings({}) if settings is None else settings
        tree = settings.applied_to(tree)
        self.tree, self.origin, self.notes, self.held = tree, origin, tree.notes, settings.held
        self.name, self.joints = tree.name, len(tree.joints)
        names = self._names = tuple(joint.name for joint in tree.joints)
        units = tuple("m" if joint.slides else "rad" for joint in tree.joints)
        self.state_names = (*(f"q_{n}" for n in names), *(f"dq_{n}" for n in names))
        self.state_units = (*units, *(f"{u}/s" for u in units))
        self.measurements = settings.channels(joint_channels(tree))
        loads = motion_loads(tree)
        controls = tuple(command_range(a, tree.joints[a.joint], loads[a.joint]) for a in tree.actuators)
        self._commands = command_channels(tree, controls)
        refuse_clashes((*self._commands, *self.measurements), self.origin or self.name)
        self._load_scales = load_scales(tree, loads, controls)
        self._delivered = tuple(
            delivered(a, tree.joints[a.joint], control)
            for a, control in zip(tree.actuators, controls, strict=True)
        )
        self.payload_sites = tuple(site.name for site in tree.sites)
        self.force_sites = tuple(body.name for body in tree.bodies)
        refuse_redundant(tree, self.origin or self.name)
        least = least_inertias(tree)
        nominal = Numbers.of(tree, {}, Steadying(least, 0.0))
        self._longest_step = longest_step(tree, nominal.passive["armature"], nominal.laws)
        self._steadying = Steadying(least, self._longest_step)
        self.push_places = push_places(tree, self._load_scales, self._payload_ways)
        self.tip = settings.tip(self.payload_sites, tip_place(tree))
        self._view = choose_view(tree)
        self._arrays = TreeArrays(tree)
        declared = visible_parameters(self, tree, declared_parameters(tree, least))
        self.parameters = settings.parameters(declared, geometry_parameters(tree))
        self._grows_with_mass = grows_with_mass(tree, [p.name for p in self.parameters])

    @classmethod
    def from_file(cls, path: str | Path) -> TreeSystem:
        """Read a robot from an MJCF or URDF file.

        Each joint of a model without actuators (a URDF file has none) gets a command in N m or N with the joint's
        name. A log need not show it: it is then 0. A file ``ROBOT.parameters.yaml`` beside ``ROBOT.xml`` overrides
        values, priors, noise and servos: see :class:`.TreeSettings`.

        Args:
            path: The file.

        Raises:
            TreeError: The file cannot be read, or is no contact-free tree of hinges and slides.
        """
        path = Path(path)
        settings = TreeSettings.beside(path)
        model, notes = read_model(path, settings.held)
        try:
            tree = compile_tree(model, path.stem)
        except TreeError as error:
            raise TreeError(f"{path}: {error}") from None
        return cls(replace(tree, notes=(*notes, *tree.notes)), str(path), settings)

    commands = property(lambda self: self._commands)
    bodies = property(lambda self: self._grows_with_mass)

    def way_to_hold(self, channels: Collection[str]) -> str:
        unseen = self.unseen_joints(channels)
        if self.origin is None or not unseen or len(unseen) == self.joints:
            return ""
        return f"; if {', '.join(unseen)} stood still, {how_to_hold(unseen, self.origin)}"

    @property
    def command_joints(self) -> tuple[int, ...]:
        return tuple(dict.fromkeys(a.joint for a in self.tree.actuators))

    drives = property(lambda self: (AS_A_LOAD,) * len(self.command_joints))
    actuator_joints = property(lambda self: tuple(a.joint for a in self.tree.actuators))
    joint_names = property(lambda self: self._names)

    load_scale = property(lambda self: max(self._load_scales))
    load_scales = property(lambda self: self._load_scales)
    longest_step = property(lambda self: self._longest_step)

    @property
    def delivered_scales(self) -> tuple[tuple[float, str], ...]:
        units = self.load_units
        return tuple(
            (most, units[a.joint]) for most, a in zip(self._delivered, self.tree.actuators, strict=True)
        )

    @property
    def drive_parameters(self) -> tuple[tuple[str, ...], ...]:
        known = {p.name for p in self.parameters}
        named = [drive_parameters(actuator) for actuator in self.tree.actuators]
        return tuple(tuple(n for n in own if n in known) for own in named)

    @property
    def tilt_parameters(self) -> tuple[Parameter, ...]:
        return tilt_parameters(self.tree.gravity)

    def effort_of(self, commands: Tensor) -> Tensor:
        return commands[..., 0] if len(self._commands) == 1 else commands

    def shape_command(self, index: int, value: Tensor, t: Tensor, parameters: Parameters) -> Tensor:
        return self._cut(index, value)

    def actuate(self, command: Tensor, parameters: Parameters) -> Tensor:
        if len(self._commands) == 1:
            return self._cut(0, command)
        return torch.stack([self._cut(k, command[..., k]) for k in range(len(self._commands))], -1)

    def command_timing(self, index: int, parameters: Parameters) -> CommandTiming:
        actuator = self.tree.actuators[index]
        lags = (time_constant(actuator, parameters),) if actuator.time_constant > 0.0 else ()
        engine = self._steadying.engine
        # The state along a log is the one that the speeds show, half a step before the positions.
        ahead = 0.0 if engine is None else engine.shown_late - engine.lead
        delay = control_delay(actuator, parameters) + ahead
        return CommandTiming(delay, lags, torch.zeros((), dtype=torch.float64))

    def channel_delays(self, parameters: Parameters) -> dict[int, Tensor]:
        late = 0.0 if self._steadying.engine is None else self._steadying.engine.shown_late
        shown = torch.tensor(late, dtype=torch.float64)
        return {} if late == 0.0 else {self.joints + j: shown for j in range(self.joints)}

    def timing(self, parameters: Parameters) -> Timing:
        zero = torch.zeros((), dtype=torch.float64)
        lags = [time_constant(a, parameters) for a in self.tree.actuators]
        delays = [control_delay(a, parameters) for a in self.tree.actuators]
        if any(not torch.equal(x, times[0]) for times in (lags, delays) for x in times):
            raise MemoryEffectError(f"the commands of {self.name} have delays or lags of their own")
        return Timing(delays[0] if delays else zero, zero, lags[0] if lags else zero)

    def delivery(self, parameters: Parameters) -> Delivery:
        laws = [actuator_law(actuator, parameters) for actuator in self.tree.actuators]
        forces = actuator_forces(self.tree.actuators, laws)
        drives = actuators_of_joints(self.tree)

        def deliver(motion: Motion) -> tuple[Tensor, ...]:
            given = forces(motion)
            together = [total([given[k] for k in drives[j]]) for j in self.command_joints]
            return tuple(
                force if isinstance(force, Tensor) else torch.full_like(motion.speeds[0], force)
                for force in together
            )

        return deliver

    def dry_friction_limits(self, parameters: Parameters) -> Levels:
        return tuple(
            torch.as_tensor(limit, dtype=torch.float64) if isinstance(limit, Tensor) or limit != 0.0 else None
            for limit in (joint_value(parameters, "frictionloss", joint) for joint in self.tree.joints)
        )

    def dry_friction_levels(self, parameters: Parameters) -> DryFriction:
        friction, engine = super().dry_friction_levels(parameters), self._steadying.engine
        softness = None if engine is None else softness_in(engine)
        if engine is None or softness is None:
            return friction
        own = Numbers.of(self.tree, parameters)
        added = ahead(engine, self.tree.actuators, self._steadying.least_inertias, own.passive, own.laws)
        return creeping(friction, softness, own.joints, own.inertias, own.passive["armature"], added)

    engines = property(lambda self: engines_with(self.tree.engine))
    engine = property(lambda self: None if self._steadying.engine is None else self._steadying.engine.name)
    engine_step = property(
        lambda self: None if self._steadying.engine is None else self._steadying.engine.step
    )

    def with_engine(self, name: str | None = MUJOCO, step: float | None = None) -> Self | None:
        engine = engine_named(self.tree.engine, name, step)
        if engine == self._steadying.engine or (name is not None and engine is None):
            return None
        other = copy(self)
        other._steadying = self._steadying._replace(engine=engine)
        other.notes = noted(self.notes, engine)
        return other

    def accelerations(self, parameters: Parameters) -> Acceleration:
        return self._law(Numbers.of(self.tree, parameters))

    def free_accelerations(self, parameters: Parameters) -> Acceleration:
        law = self._law(Numbers.of(self.tree, parameters, self._steadying).without_dry_friction())
        late = 0.0 if self._steadying.engine is None else self._steadying.engine.late
        return law if late == 0.0 else with_late_speeds(law, late)

    def rollout(self, parameters: Parameters) -> TreeRollout | None:
        numbers = Numbers.of(self.tree, parameters, self._steadying).without_dry_friction()
        fast = numbers.without_forces().fast(self._arrays)
        if fast is None or not is_plain([x for force in numbers.forces for x in force.force]):
            return None
        late = 0.0 if self._steadying.engine is None else self._steadying.engine.late
        return TreeRollout(fast, numbers.forces, late=late, impulsive=self.own_step is not None)

    def rolls(self, effect: Effect) -> bool:
        if effect.place == "load":
            return effect.steady or is_known(effect.name)
        return effect.place != "memory"

    def inverse_inertia(self, parameters: Parameters) -> InverseInertia:
        own = Numbers.of(self.tree, parameters, self._steadying)
        joints, fast = own.joints, own.without_forces().fast(self._arrays)

        def inverse(motion: Motion) -> tuple[tuple[Tensor, ...], ...]:
            if fast is not None and is_plain(motion.angles):
                return fast.inverse_inertia(motion.angles)
            return inverse_mass(joints, own.inertias, own.passive["armature"], motion.angles)

        return inverse

    def needed_loads(
        self, parameters: Parameters
    ) -> Callable[[Motion, Sequence[Tensor]], tuple[Tensor, ...]]:
        """(motion, accelerations) -> outside load on each joint [N m or N] under which it moves so."""
        own = Numbers.of(self.tree, parameters)
        law = self._law(own)

        def loads(motion: Motion, accelerations: Sequence[Tensor]) -> tuple[Tensor, ...]:
            missing = [a - b for a, b in zip(accelerations, law(motion), strict=True)]
            mass = mass_matrix(own.joints, own.inertias, own.passive["armature"], motion.angles)
            rows = range(self.joints)
            return tuple(total([mul(mass[max(j, k)][min(j, k)], missing[k]) for k in rows]) for j in rows)

        return loads

    def gravity(self, parameters: Parameters) -> Triple:
        """Gravity in the frame of the base, which may be turned about two of its axes [m/s2]."""
        return turned_gravity(self.tree.gravity, parameters)

    def _law(self, numbers: Numbers) -> Acceleration:
        return equations_of_motion(self.tree, numbers, self._arrays, self.smoothing_speeds)

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        parts = state.unbind(-1)
        speeds = parts[self.joints :]
        efforts = (effort,) if len(self._commands) == 1 else effort.unbind(-1)
        law = self._law(Numbers.of(self.tree, parameters, self._steadying))
        accelerations = law(Motion(parts[: self.joints], speeds, efforts))
        return torch.stack(torch.broadcast_tensors(*speeds, *accelerations), -1)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return self.with_payload_at(self.tip, mass, parameters)

    def with_payload_at(
        self, site: str, mass: Tensor, parameters: Parameters, along: Tensor | None = None
    ) -> Parameters:
        """Parameters after a point mass ``mass`` (...) [kg] is fixed to one of `payload_sites`.

        Args:
            site: A site of the model, or a body: then the mass is at its centre of mass, or ``along`` its link.
            mass: (...) [kg].
            parameters: Those before.
            along: (...) distance from the body's joint along its link, see `payload_way` [m].

        Raises:
            TreeError: There is no such place.
        """
        if site not in self.payload_sites:
            raise TreeError(f'{self.name} has no place "{site}"; it has: {", ".join(self.payload_sites)}')
        name = payload_name(site)
        before = parameters.get(name)
        placed = {} if along is None else {payload_place_name(site): along}
        return {**parameters, **placed, name: mass if before is None else before + mass}

    def payload_way(self, site: str) -> PayloadWay | None:
        return self._payload_ways.get(site)

    @cached_property
    def _payload_ways(self) -> dict[str, PayloadWay]:
        return payload_ways(self.tree)

    def force_parameters(self, site: str) -> tuple[Parameter, ...]:
        return self._force_parameters.get(site, ())

    @cached_property
    def _force_parameters(self) -> dict[str, tuple[Parameter, ...]]:
        return force_parameters(self.tree, self._load_scales)

    def with_force_at(self, site: str, force: Parameters, parameters: Parameters) -> Parameters:
        """Parameters under a force at the centre of mass of a body.

        Args:
            site: One of `force_sites`.
            force: x, y or z -> (...) component along that axis of the world [N].
            parameters: Those before; a force that they have already is added to.

        Raises:
            TreeError: There is no such body.
        """
        if site not in self.force_sites:
            raise TreeError(f'{self.name} has no body "{site}"; it has: {", ".join(self.force_sites)}')
        added = {force_name(site, axis): value for axis, value in force.items()}
        return {**parameters, **{n: v + parameters[n] if n in parameters else v for n, v in added.items()}}

    def loads_of_push(self, place: int, point: Tensor, angles: Sequence[Tensor]) -> Tensor:
        return loads_of_push(self.tree, self.push_places[place], point, angles)

    def outline(self, angles: np.ndarray) -> Outline:
        return lines(self.tree, angles, self._view)

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        angles = np.nan_to_num(np.asarray(measurement, dtype=float)[: self.joints])
        fractions = None
        if command is not None and self._commands:
            sizes = [max(abs(c.low), abs(c.high)) for c in self._commands]
            fractions = [u / size for u, size in zip(np.ravel(command), sizes, strict=True)]
        draw_robot(image, self.tree, angles, self._view, self.command_joints, fractions)

    def _cut(self, index: int, value: Tensor) -> Tensor:
        low, high = self.tree.actuators[index].low, self.tree.actuators[index].high
        return clipped(value, low, high)
