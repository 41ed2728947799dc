"""What every dynamical system declares: named parameters, channels, equations of motion."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Collection, Sequence
from functools import cached_property
from typing import Self

import torch
from torch import Tensor

from deepkoco.old_names import moved_names
from deepkoco.systems.channel import Channel
from deepkoco.systems.declared import Declared
from deepkoco.systems.drawn import Drawn
from deepkoco.systems.drives import Drive, drives_of
from deepkoco.systems.dry_friction import DryFriction, Levels
from deepkoco.systems.engine_names import MUJOCO, SEMI_IMPLICIT
from deepkoco.systems.joint_memory import JointMemory
from deepkoco.systems.motion import Acceleration, InverseInertia, Motion, PayloadWay, PushPlace
from deepkoco.systems.named_joints import NamedJoints
from deepkoco.systems.parameter import Parameter, ParameterError, Parameters
from deepkoco.systems.rollout import RolledEffect, Rollout
from deepkoco.systems.signal_path import SignalPath
from deepkoco.systems.typical_loads import typical_loads

__getattr__ = moved_names(__name__)


class System(SignalPath, NamedJoints, Drawn, metaclass=Declared):
    """Dynamics with named parameters, command channels and measurement channels.

    A subclass declares ``joint_units`` (or ``joints``, ``state_names`` and ``state_units``), ``parameters``,
    ``commands``, ``measurements``, and its equations: `accelerations` or `derivative`. All else has a default. What it
    declares is checked when it is made.

    A system is pure: its methods neither keep state nor draw random numbers. Every method is
    elementwise over the leading batch shape; a parameter is a scalar tensor or has the batch shape, so
    a population of parameters is one more batch.

    Attributes:
        joint_units: Of each joint: ``"rad"`` for one that turns, ``"m"`` for one that slides.
        joints: How many; a state begins with the angles of all joints, then their speeds.
        wraps: Whether it only passes on what another system declares, which is then not checked again.
        dry_friction: Whether its joints can have any (a joint that flies cannot).
        resizable: Whether `with_length` can change its links.
        tilt_parameters: What `tilt` of its base adds to the parameters; empty where gravity plays no part.
        payload_sites: Places at which `with_payload_at` can fix a payload; each is a cause of its own,
            ``payload(PLACE)``.
        tip: The one of them that `with_payload` means; None if it is another place.
        force_sites: Places at which an outside force can act; each is a cause of its own, ``force(PLACE)``.
        push_places: Bodies on which a push loads several joints; each is a cause of its own, ``body_push(BODY)``.
        origin: Text by which `load_system` finds it again, such as ``/home/me/my_robot.py:CartPole``; None for a system
            of the package.
        notes: Sentences on what its file has and the system leaves out or changes.
    """

    dry_friction = True
    resizable = False
    payload_sites: tuple[str, ...] = ()
    tip: str | None = None
    force_sites: tuple[str, ...] = ()
    push_places: tuple[PushPlace, ...] = ()
    origin: str | None = None
    notes: tuple[str, ...] = ()
    wraps = False

    name: str
    joints: int
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    measurements: tuple[Channel, ...]

    @property
    @abstractmethod
    def commands(self) -> tuple[Channel, ...]:
        """The command channels, M of them."""

    @property
    def has_equations(self) -> bool:
        """Whether it defines `accelerations` or `derivative`."""
        return self.has_accelerations or type(self).derivative is not System.derivative

    @property
    def has_accelerations(self) -> bool:
        """Whether it defines `accelerations`; they are taken from its derivative else."""
        return type(self).accelerations is not System.accelerations

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        """Time derivative of the state, by default from the accelerations.

        Args:
            state: (..., S), units ``state_units``.
            effort: (..., M), for one command (...): what the actuators deliver, in the commands' units.
            parameters: Named values, each scalar or (...).

        Returns:
            (..., S), units of the state per second.
        """
        parts = state.unbind(-1)
        speeds = parts[self.joints : 2 * self.joints]
        efforts = (effort,) if len(self.commands) == 1 else effort.unbind(-1)
        accelerations = self.accelerations(parameters)(Motion(parts[: self.joints], speeds, efforts))
        return torch.stack(torch.broadcast_tensors(*speeds, *accelerations), -1)

    @property
    def shown_pairs(self) -> tuple[tuple[int, int], ...]:
        """(a, b) where what shows the position of joint b may show a share of that of joint a too.

        These are all pairs of three joints, else neighbours, of which both positions are measured.
        """
        shown = [j for j in range(self.joints) if j in self.measured_states] if self.shows_states else []
        near = self.joints if self.joints <= 3 else 1
        return tuple((a, b) for a in shown for b in shown if 0 < abs(a - b) <= near)

    def unseen_joints(self, channels: Collection[str]) -> list[str]:
        """Names of the joints of which neither a measurement nor a command is among these channels of a log."""
        measured = zip((c.name for c in self.measurements), self.measured_states, strict=True)
        driven = zip((c.name for c in self.commands), self.actuator_joints, strict=False)
        seen = {
            state % self.joints for name, state in measured if name in channels and state < 2 * self.joints
        }
        seen |= {joint for name, joint in driven if name in channels}
        return [name for joint, name in enumerate(self.joint_names) if joint not in seen]

    def way_to_hold(self, channels: Collection[str]) -> str:
        """End of a message on a log with only these channels: what to write where if its unseen joints stood still.

        It is empty where every joint is seen, or where joints cannot be held.
        """
        return ""

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        """Parameters after a point mass ``mass`` (...) [kg] is fixed to the tip.

        Raises:
            ParameterError: The system does not say what a payload changes.
        """
        raise ParameterError(f"{self.name} does not say what a payload changes; define its with_payload")

    @property
    def takes_payload(self) -> bool:
        """Whether it defines `with_payload`."""
        return type(self).with_payload is not System.with_payload

    def with_payload_at(
        self, site: str, mass: Tensor, parameters: Parameters, along: Tensor | None = None
    ) -> Parameters:
        """Parameters after a point mass ``mass`` (...) [kg] is fixed at one of `payload_sites`.

        Args:
            site: The place.
            mass: (...) [kg].
            parameters: Those before.
            along: (...) distance along the link, for a site with a `payload_way`; None takes its `at` [m].

        Raises:
            ParameterError: There is no such place.
        """
        raise ParameterError(f'{self.name} has no place "{site}" for a payload; define its payload_sites')

    def payload_way(self, site: str) -> PayloadWay | None:
        """The line along a link on which a payload at a site may hang; None where its place is known."""
        return None

    def force_parameters(self, site: str) -> tuple[Parameter, ...]:
        """Components of an outside force at one of `force_sites`, in the frame of the world [N]."""
        return ()

    def with_force_at(self, site: str, force: Parameters, parameters: Parameters) -> Parameters:
        """Parameters under an outside force; ``force`` has the names of `force_parameters`.

        Raises:
            ParameterError: There is no such place.
        """
        raise ParameterError(f'{self.name} has no place "{site}" for a force; define its force_sites')

    def loads_of_push(self, place: int, point: Tensor, angles: Sequence[Tensor]) -> Tensor:
        """Loads (3, J, ...) of pushes of 1 N along the axes of the world at one of `push_places` [N m or N per N].

        Args:
            place: Its number.
            point: (3, ...) distances `POINT` of the pushed point from the body's centre of mass [m].
            angles: J coordinates (...) [rad or m]; they broadcast against an entry of ``point``.

        Raises:
            ParameterError: There is no such place.
        """
        raise ParameterError(f"{self.name} has no place {place} for a push; define its push_places")

    def accelerations(self, parameters: Parameters) -> Acceleration:
        """The equations of motion with everything that only parameters decide computed once.

        By default they are taken from `derivative`. An outside load then acts as a part of the command that drives its
        joint with a force or a torque; loads on other joints have no effect, see `loaded_joints`.

        Args:
            parameters: Named values, each scalar or of a shape that broadcasts against the motion's.

        Returns:
            Motion -> J accelerations [rad/s2 or m/s2].
        """
        joints, forces = self.joints, self._force_commands

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            efforts = list(motion.efforts)
            for joint, command in forces.items():
                efforts[command] = efforts[command] + motion.load(joint)
            state = torch.stack(torch.broadcast_tensors(*motion.angles, *motion.speeds), -1)
            effort = efforts[0] if len(efforts) == 1 else torch.stack(torch.broadcast_tensors(*efforts), -1)
            return self.derivative(state, effort, parameters)[..., joints:].unbind(-1)

        return acceleration

    @property
    def loaded_joints(self) -> tuple[int, ...]:
        """Joints on which outside loads act, and so all effects that are loads.

        All where `accelerations` is defined; else those that a command drives with a force [N] or a torque [N m].
        """
        if self.has_accelerations:
            return tuple(range(self.joints))
        return tuple(sorted(self._force_commands))

    @property
    def _force_commands(self) -> dict[int, int]:
        """Joint -> command that is a force or a torque on it."""
        units = self.load_units
        return {j: k for k, j in enumerate(self.command_joints) if self.commands[k].unit == units[j]}

    def dry_friction_limits(self, parameters: Parameters) -> Levels:
        """Largest dry friction of each joint at standstill (J) [N m or N]; None for a joint whose equations have none.

        A system whose equations have dry friction declares it here. A simulation along a log then lets the joint
        stick: it takes :meth:`free_accelerations` and adds the friction itself. Without this method a friction that
        the equations contain acts as it is written there.
        """
        return (None,) * self.joints

    def dry_friction_levels(self, parameters: Parameters) -> DryFriction:
        """Levels of the dry friction of each joint, for a simulation in which joints stick."""
        limits = self.dry_friction_limits(parameters)
        return DryFriction(limits, tuple(j for j, limit in enumerate(limits) if limit is not None))

    @property
    def bodies(self) -> dict[str, dict[str, float]]:
        """Bodies -> what grows with the mass of each in the same shape: names of parameters and values as given.

        A name need not be one of :attr:`parameters`, where no motion shows it; the equations then know it all the same.
        """
        return {}

    @property
    def engines(self) -> tuple[str, ...]:
        """Engines that may have simulated its logs (:mod:`.engine_names`), that of its file first."""
        return ()

    @property
    def engine(self) -> str | None:
        """Engine whose steps and friction it is simulated with along logs; None for a real machine."""
        return None

    @property
    def engine_step(self) -> float | None:
        """Step of that engine [s]; None for a real machine."""
        return None

    @property
    def own_step(self) -> float | None:
        """Step of simulations that are v' = v + h a(q, v), q' = q + h v' [s], and not of an equation of motion.

        They are taken as they are, in no other length: an error of such a step belongs to what is simulated.
        """
        return self.engine_step if self.engine == SEMI_IMPLICIT else None

    def with_engine(self, name: str | None = MUJOCO, step: float | None = None) -> Self | None:
        """The system as an engine simulates it; None if it is so in this step already, or is not among `engines`.

        Commands act as early as in the engine's steps; in MuJoCo friction creeps (:mod:`deepkoco.systems.creep`).

        Args:
            name: Of the engine; None for the machine of a system that is simulated so.
            step: Of the engine [s]; None: that of the file, as MuJoCo reads it (2 ms where it states none).
        """
        return None

    def joint_memory(self, parameters: Parameters) -> JointMemory:
        """What effects remember of the ways of the joints; nothing for a plain system."""
        return JointMemory(())

    def free_accelerations(self, parameters: Parameters) -> Acceleration:
        """As :meth:`accelerations`, without the dry friction that :meth:`dry_friction_limits` declares.

        The default asks :meth:`accelerations` for an infinite ``smoothing`` at these joints: tanh(speed / smoothing)
        is then 0. Equations that leave such friction out, whatever the smoothing, need no change either.
        """
        law = self.accelerations(parameters)
        limits = self.dry_friction_limits(parameters)
        if all(limit is None for limit in limits):
            return law
        smoothing = tuple(
            torch.full((), speed if limit is None else math.inf, dtype=torch.float64)
            for speed, limit in zip(self.smoothing_speeds, limits, strict=True)
        )

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            return law(motion._replace(smoothing=smoothing))

        return acceleration

    def inverse_inertia(self, parameters: Parameters) -> InverseInertia:
        """Answer of the accelerations to unit loads: motion -> J rows of J columns [1/(kg m2) or 1/kg].

        The default applies a unit load to each joint in turn. A system may compute it faster.
        """
        law, joints = self.free_accelerations(parameters), range(self.joints)

        def inverse(motion: Motion) -> tuple[tuple[Tensor, ...], ...]:
            bare = motion._replace(loads=None)
            free = law(bare)
            one = torch.ones_like(motion.speeds[0])
            columns = [
                law(bare._replace(loads=tuple(one if k == j else None for k in joints))) for j in joints
            ]
            return tuple(tuple(columns[k][j] - free[j] for k in joints) for j in joints)

        return inverse

    def with_length(self, factor: Tensor, joint: int, parameters: Parameters) -> Parameters:
        """Parameters after the link behind a joint is ``factor`` (...) times as long, at the same mass.

        Raises:
            ParameterError: The system has no such link.
        """
        raise ParameterError(f"{self.name} has no link whose length could change")

    @property
    def tilt_parameters(self) -> tuple[Parameter, ...]:
        """Parameters that tilt the direction of gravity [rad]; a system without any stands level."""
        return ()

    @property
    def load_scales(self) -> tuple[float, ...]:
        """Typical load of each joint [N m or N]: the unit in which bounds of extra loads are set.

        By default ``load_scale`` if that is given, else what gravity, springs and actuators make at rest.
        """
        if type(self).load_scale is not System.load_scale:
            return (self.load_scale,) * self.joints
        return self._typical_loads

    @cached_property
    def _typical_loads(self) -> tuple[float, ...]:
        return typical_loads(self)

    @property
    def drives(self) -> tuple[Drive, ...]:
        """Of each command in `command_joints`: whether its effort acts as a load on its joint does."""
        return self._drives

    @cached_property
    def _drives(self) -> tuple[Drive, ...]:
        return drives_of(self)

    @property
    def longest_step(self) -> float:
        """Longest Runge-Kutta step [s] that follows the system's fastest motion; infinite: found from its period.

        A stiff servo inside the system needs shorter steps than the motion that a log shows.
        """
        return math.inf

    def rollout(self, parameters: Parameters) -> Rollout | None:
        """Simulations along logs as one compiled loop, of the motion of :meth:`free_accelerations`; None for none."""
        return None

    def rolls(self, effect: RolledEffect) -> bool:
        """Whether :meth:`rollout` can be had together with an effect, if it can be had at all."""
        return True

    @property
    def load_scale(self) -> float:
        """Typical load of the last joint, for what is fixed to its tip [N m or N]."""
        return self.load_scales[-1]

    def default_parameters(self) -> dict[str, Tensor]:
        """Nominal parameters as float64 scalars."""
        return {p.name: torch.tensor(p.value, dtype=torch.float64) for p in self.parameters}

    def parameter(self, name: str) -> Parameter:
        """Declaration of one parameter.

        Raises:
            ParameterError: There is no such parameter.
        """
        for declared in self.parameters:
            if declared.name == name:
                return declared
        known = ", ".join(p.name for p in self.parameters)
        raise ParameterError(f'{self.name} has no parameter "{name}"; it has: {known}')
