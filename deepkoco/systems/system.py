"""What every dynamical system declares: named parameters, channels, equations of motion."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.declaration import Declared
from deepkoco.systems.drawing import Point, canvas, draw_bars
from deepkoco.systems.dry_friction import DryFriction, Levels
from deepkoco.systems.rollout import Rollout
from deepkoco.systems.typical_loads import typical_loads

if TYPE_CHECKING:
    from deepkoco.systems.effects.effect import Effect
    from deepkoco.systems.joint_memory import JointMemory

Parameters = Mapping[str, Tensor]

UNREADABLE = "().,;"  # in the name of a joint: names of parameters are read by them

# By the unit of a joint. An encoder of a rail resolves a tenth of a millimetre, one of a joint that turns a milliradian
# or two: while friction holds it, a joint must not creep by more.
SMOOTHING = {"rad": 0.05, "m": 0.0004}  # speed over which the sign of dry friction is smoothed [rad/s, m/s]


class ParameterError(ValueError):
    """A parameter name is unknown or its value is outside its bounds."""


@dataclass(frozen=True)
class Parameter:
    """One named physical quantity.

    Attributes:
        name: Name by which every part of the package speaks of it.
        value: Nominal value, in ``unit``.
        unit: SI unit as text, e.g. ``"kg m2"``.
        low: Smallest admissible value.
        high: Largest admissible value.
        prior_sd: Standard deviation of the prior around ``value``, in ``unit``.
        description: One phrase with the symbol of the equation.
    """

    name: str
    value: float
    unit: str
    low: float
    high: float
    prior_sd: float
    description: str

    def __post_init__(self) -> None:
        if not (self.low <= self.value <= self.high):
            raise ParameterError(
                f"{self.name} = {self.value} {self.unit} is outside [{self.low}, {self.high}]"
            )
        if not self.prior_sd > 0:
            raise ParameterError(f"{self.name}: prior_sd must be positive, got {self.prior_sd}")


@dataclass(frozen=True)
class Channel:
    """One signal that crosses the boundary of the system.

    Attributes:
        name: Name of the signal.
        unit: SI unit as text.
        kind: ``"command"`` or ``"measurement"``.
        low: Lower limit of the signal (``-inf`` if none).
        high: Upper limit of the signal (``inf`` if none).
        noise_sd: Typical standard deviation of the sensor noise, in ``unit`` (0 for a command).
        description: One phrase.
        angle: Whether the signal is an angle that may be wrapped by a sensor.
        zero_sd: Standard deviation of the sensor's zero from one log to the next, in ``unit``.
        default: Value of a command that a log does not show; None if every log must show it.
    """

    name: str
    unit: str
    kind: str
    low: float = -math.inf
    high: float = math.inf
    noise_sd: float = 0.0
    description: str = ""
    angle: bool = False
    zero_sd: float = 0.0
    default: float | None = None


class Timing(NamedTuple):
    """Delays that a system carries besides its equations, all in seconds."""

    actuation_delay: Tensor  # command sent -> command acts
    sensing_delay: Tensor  # state -> measurement stamped
    lag: Tensor  # time constant of the actuator's first-order lag


class CommandTiming(NamedTuple):
    """What happens in time to one command on its way to the joint."""

    delay: Tensor  # sensing delay included: along a log the two act alike [s]
    lag: tuple[Tensor, ...]  # time constants of first-order lags in series [s]
    skew: Tensor  # seconds that the measurements' clock gains per second


class PayloadWay(NamedTuple):
    """The line along a link on which a payload may hang, by its distance from the link's joint.

    Attributes:
        at: Where it is taken to hang if nothing else is known [m].
        low, high: Bounds [m].
        sd: Standard deviation of its prior [m].
    """

    at: float
    low: float
    high: float
    sd: float


class Motion(NamedTuple):
    """Joint coordinates and what acts on them; every tensor has the batch shape (...)."""

    angles: tuple[Tensor, ...]  # J joint coordinates [rad or m]
    speeds: tuple[Tensor, ...]  # J, per second
    efforts: tuple[Tensor, ...]  # M, in the commands' units
    loads: tuple[Tensor | None, ...] | None = None  # J outside loads [N m or N]
    time: Tensor | None = None  # log time [s]
    # J speeds over which the sign of dry friction changes; infinite where dry friction is left out
    smoothing: tuple[Tensor, ...] | None = None

    def load(self, joint: int) -> Tensor | float:
        """Outside load on a joint [N m or N]; 0 where there is none."""
        given = None if self.loads is None else self.loads[joint]
        return 0.0 if given is None else given


Outline = tuple[list[tuple[Point, Point]], list[Point]]
Acceleration = Callable[[Motion], tuple[Tensor, ...]]
Delivery = Callable[[Motion], tuple[Tensor, ...]]
InverseInertia = Callable[[Motion], tuple[tuple[Tensor, ...], ...]]


class System(metaclass=Declared):
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
        origin: Text by which `load_system` finds it again, such as ``/home/me/my_robot.py:CartPole``; None for a system
            of the package.
        notes: Sentences on what its file has and the system leaves out or changes.
    """

    dry_friction = True
    resizable = False
    payload_sites: tuple[str, ...] = ()
    tip: str | None = None
    force_sites: tuple[str, ...] = ()
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

    def effort_of(self, commands: Tensor) -> Tensor:
        """Commands (..., M) in the shape that `actuate` and `derivative` take: the same, or (...) for one command."""
        return commands[..., 0] if len(self.commands) == 1 else commands

    @property
    def has_equations(self) -> bool:
        """Whether it defines `accelerations` or `derivative`."""
        kind = type(self)
        return kind.accelerations is not System.accelerations or kind.derivative is not System.derivative

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
            return self.derivative(state, effort, parameters)[..., joints : 2 * joints].unbind(-1)

        return acceleration

    @property
    def loaded_joints(self) -> tuple[int, ...]:
        """Joints on which outside loads act, and so all effects that are loads.

        All where `accelerations` is defined; else those that a command drives with a force [N] or a torque [N m].
        """
        if type(self).accelerations is not System.accelerations:
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

    def joint_memory(self, parameters: Parameters) -> JointMemory:
        """What effects remember of the ways of the joints; nothing for a plain system."""
        from deepkoco.systems.joint_memory import JointMemory

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
        return ()

    @property
    def command_joints(self) -> tuple[int, ...]:
        """Joint that each command drives; commands beyond these only switch something."""
        return tuple(range(len(self.commands)))

    @property
    def coupled_joints(self) -> tuple[tuple[int, int], ...]:
        """(a, b) where a share of what drives joint a may reach joint b: all pairs of three joints, else neighbours."""
        driven = [j for j in dict.fromkeys(self.command_joints) if j < self.joints]
        near = self.joints if self.joints <= 3 else 1
        return tuple((a, b) for a in driven for b in range(self.joints) if 0 < abs(a - b) <= near)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Name of each joint in reports and, of several joints, in the names of effects: ``coulomb(cart)``."""
        return tuple(f"joint {j + 1}" for j in range(self.joints))

    def at_joint(self, name: str, joint: int) -> str:
        """Name of an effect or a cause at one joint: ``coulomb(joint 2)``; without the joint where there is one only.

        Raises:
            ParameterError: A name of a joint is given twice, or holds a sign that names of parameters are read by.
        """
        if self.joints == 1:
            return name
        names = self.joint_names
        if len(set(names)) != self.joints or any(not n or set(n) & set(UNREADABLE) for n in names):
            raise ParameterError(
                f"{self.name}: joint_names = {names!r}: give {self.joints} different names without {UNREADABLE}"
            )
        return f"{name}({names[joint]})"

    @property
    def measured_states(self) -> tuple[int, ...]:
        """State that each measurement shows: the one of its name; else the first, the second, and so on."""
        names = [channel.name for channel in self.measurements]
        if set(names) <= set(self.state_names):
            return tuple(self.state_names.index(name) for name in names)
        return tuple(range(len(names)))

    @property
    def shows_states(self) -> bool:
        """Whether sensors without any error show states as they are."""
        return type(self).ideal_measurement is System.ideal_measurement

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
    def smoothing_speeds(self) -> tuple[float, ...]:
        """Speed of each joint over which `derivative` smooths the sign of dry friction [rad/s or m/s].

        There a joint that friction holds creeps at up to this speed: choose one at which it moves by less than its
        sensor's noise while it sticks. Simulations along a log know no such speed: joints stick in them.
        """
        return tuple(SMOOTHING[u] for u in self._kinds)

    @property
    def longest_step(self) -> float:
        """Longest Runge-Kutta step [s] that follows the system's fastest motion; infinite: found from its period.

        A stiff servo inside the system needs shorter steps than the motion that a log shows.
        """
        return math.inf

    @property
    def _kinds(self) -> tuple[str, ...]:
        """Unit of each joint: a joint that does not turn slides."""
        return tuple("rad" if unit == "rad" else "m" for unit in self.state_units[: self.joints])

    @property
    def load_units(self) -> tuple[str, ...]:
        """Unit of the load on each joint."""
        return tuple("N m" if unit == "rad" else "N" for unit in self.state_units[: self.joints])

    @property
    def per_speed_units(self) -> tuple[str, ...]:
        """Unit of a load per speed of each joint."""
        return tuple(f"{load} s/{u}" for load, u in zip(self.load_units, self.state_units, strict=False))

    @property
    def per_speed_squared_units(self) -> tuple[str, ...]:
        """Unit of a load per squared speed of each joint."""
        return tuple(f"{load} s2/{u}2" for load, u in zip(self.load_units, self.state_units, strict=False))

    def rollout(self, parameters: Parameters) -> Rollout | None:
        """Simulations along logs as one compiled loop, of the motion of :meth:`free_accelerations`; None for none."""
        return None

    def rolls(self, effect: Effect) -> bool:
        """Whether :meth:`rollout` can be had together with an effect, if it can be had at all."""
        return True

    def delivery(self, parameters: Parameters) -> Delivery | None:
        """What actuators deliver, for each command that drives a joint; None where it is the effort itself."""
        return None

    @property
    def delivered_scales(self) -> tuple[tuple[float, str], ...]:
        """Size and unit of what the actuator of each driving command delivers at most, or typically."""
        driving = self.commands[: len(self.command_joints)]
        return tuple((max(abs(c.low), abs(c.high)), c.unit) for c in driving)

    def shape_command(self, index: int, value: Tensor, t: Tensor, parameters: Parameters) -> Tensor:
        """Effort that answers the log of one command, before lag and delay.

        Args:
            index: Which command.
            value: (n, 1) or (n, L).
            t: (n,) stamps [s].
            parameters: Named values, scalar or (L,).

        Returns:
            (n, L), or (n, 1) where no parameter has lanes.
        """
        return value

    def command_timing(self, index: int, parameters: Parameters) -> CommandTiming:
        """Delay, lags and clock of one command; none for a plain system."""
        zero = torch.zeros((), dtype=torch.float64)
        return CommandTiming(zero, (), zero)

    def sensor_filter(self, parameters: Parameters) -> Tensor:
        """Time constant of a first-order filter behind all sensors [s]; 0 for a plain system."""
        return torch.zeros((), dtype=torch.float64)

    def output_play(self, parameters: Parameters) -> Levels:
        """Half of the play between each joint and its sensors (J), in its unit; None for none, as in a plain system."""
        return (None,) * self.joints

    def measure_at(self, state: Tensor, time: Tensor, parameters: Parameters) -> Tensor:
        """As :meth:`measure` along a log, ``time`` (...) since its first command [s]."""
        return self.measure(state, parameters)

    def actuate(self, command: Tensor, parameters: Parameters) -> Tensor:
        """Effort that answers a command of its shape, without dynamics: the command itself for a plain system."""
        return command

    def timing(self, parameters: Parameters) -> Timing:
        """Delays of command and measurements: zero for a plain system."""
        zero = torch.zeros((), dtype=torch.float64)
        return Timing(zero, zero, zero)

    def measure(self, state: Tensor, parameters: Parameters) -> Tensor:
        """Noise-free measurements (..., N) of a state (..., S), in the order of ``measurements``."""
        return self.ideal_measurement(state)

    def measure_shown(self, shown: Tensor, parameters: Parameters) -> Tensor:
        """As :meth:`measure`, of a state (..., S) with the positions and speeds behind the :meth:`output_play`."""
        return self.measure(shown, parameters)

    def ideal_measurement(self, state: Tensor) -> Tensor:
        """What sensors without any error measure (..., N) of a state (..., S): by default the `measured_states`."""
        shown = self.measured_states
        if shown == tuple(range(state.shape[-1])):
            return state
        return torch.stack([state[..., index] for index in shown], -1)

    @property
    def load_scale(self) -> float:
        """Typical load of the last joint, for what is fixed to its tip [N m or N]."""
        return self.load_scales[-1]

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        """Draw the system onto a picture, whatever that shows already: by default a bar for each channel.

        Args:
            image: uint8 (size, size, 3), RGB, of any size; it may be a part of a larger picture.
            measurement: (N,) values in the order of ``measurements``.
            command: Commands now (M,), in their units, to be drawn too.
        """
        shown = None if command is None else np.ravel(command)
        draw_bars(
            image,
            [_share(value, c) for value, c in zip(measurement, self.measurements, strict=False)],
            []
            if shown is None
            else [_share(value, c) for value, c in zip(shown, self.commands, strict=False)],
        )

    def outline(self, angles: np.ndarray) -> Outline | None:
        """Lines of its links and points of its joints in a plane [m], for figures; None where there are none.

        Args:
            angles: (J,) joint coordinates [rad or m].
        """
        return None

    def draw(self, measurement: np.ndarray, command: np.ndarray | float, size: int = 256) -> np.ndarray:
        """Picture of the system on an empty background, uint8 (size, size, 3), RGB; see `draw_on`."""
        image = canvas(size)
        self.draw_on(image, measurement, command)
        return image

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


def _share(value: float, channel: Channel) -> float:
    """A value in [-1, 1] for a picture: of the channel's limits, of half a turn, or softly bounded."""
    if channel.angle or (channel.unit == "rad" and not math.isfinite(channel.high)):
        return math.remainder(float(value), 2.0 * math.pi) / math.pi
    largest = max(abs(channel.low), abs(channel.high))
    return float(value) / largest if math.isfinite(largest) and largest > 0 else math.tanh(float(value))


def rk4_step(
    system: System, state: Tensor, effort: Tensor, dt: Tensor | float, parameters: Parameters
) -> Tensor:
    """One step of the classical Runge-Kutta method under a constant effort.

    Args:
        system: Dynamics.
        state: (..., S).
        effort: (..., M), for one joint (...), held over the step.
        dt: Step [s], scalar or (...).
        parameters: Named values, each scalar or (...).

    Returns:
        State (..., S) after ``dt``.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.1.
    """
    h = dt.unsqueeze(-1) if isinstance(dt, Tensor) and dt.ndim > 0 else dt
    k1 = system.derivative(state, effort, parameters)
    k2 = system.derivative(state + 0.5 * h * k1, effort, parameters)
    k3 = system.derivative(state + 0.5 * h * k2, effort, parameters)
    k4 = system.derivative(state + h * k3, effort, parameters)
    return state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
