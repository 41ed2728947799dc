"""Names and units of joints, and which command drives which."""

from __future__ import annotations

from deepkoco.systems.channel import Channel
from deepkoco.systems.drives import Drive
from deepkoco.systems.parameter import ParameterError

COMMON = "all"  # in the name of an effect that all driving commands have in common: ``gain(all)``
UNREADABLE = "().,;"  # in the name of a joint: names of parameters are read by them

# By the unit of a joint. An encoder of a rail resolves a tenth of a millimetre, one of a joint that turns a milliradian
# or two: while friction holds it, a joint must not creep by more.
SMOOTHING = {"rad": 0.05, "m": 0.0004}  # speed over which the sign of dry friction is smoothed [rad/s, m/s]


class NamedJoints:
    """The joints of a system: what they are called, and in which units they and their loads count.

    Attributes:
        name: Name of the system.
        joints: How many.
        state_units: Units of the states, those of the joint coordinates first.
        commands: The command channels.
        drives: Of each command in `command_joints`: whether its effort acts as a load on its joint does.
    """

    name: str
    joints: int
    state_units: tuple[str, ...]
    commands: tuple[Channel, ...]

    @property
    def drives(self) -> tuple[Drive, ...]:
        raise NotImplementedError

    @property
    def own_joints(self) -> int:
        """Number of joints at which effects act; any further coordinates only follow them."""
        return self.joints

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

    def at_command(self, name: str, command: int) -> str:
        """Name of an effect or a cause of one actuator: that of its joint, or its own where the joint does not tell.

        Two propellers tilt one beam, and one of them may be weak: ``gain(left)``. A thruster of a boat pushes it north,
        east and round.
        """
        joint, own = self.command_joints[command], self.commands[command].name
        if self.command_joints.count(joint) == 1:
            unclear = own in (*self.joint_names, COMMON) or bool(set(own) & set(UNREADABLE))
            if self.joints == 1 or unclear or self.drives[command].along:
                return self.at_joint(name, joint)
        return f"{name}({own})"

    def timing_at(self, name: str, command: int) -> str:
        """Name of the delay or lag of any command; empty for a switch of a system of several joints, which has none."""
        if command < len(self.command_joints):
            return self.at_command(name, command)
        if self.joints > 1 and command >= len(self.actuator_joints):
            return ""
        return self.at_joint(name, 0 if self.joints == 1 else self.actuator_joints[command])

    @property
    def command_joints(self) -> tuple[int, ...]:
        """Joint that each command drives; commands beyond these only switch something."""
        return tuple(range(len(self.commands)))

    @property
    def actuator_joints(self) -> tuple[int, ...]:
        """As `command_joints`, with further actuators of joints that have one, whose timing is that of the first."""
        return self.command_joints

    @property
    def coupled_joints(self) -> tuple[tuple[int, int], ...]:
        """(a, b) where a share of what drives joint a may reach joint b: all pairs of three joints, else neighbours."""
        driven = [j for j in dict.fromkeys(self.command_joints) if j < self.joints]
        near = self.joints if self.joints <= 3 else 1
        return tuple((a, b) for a in driven for b in range(self.joints) if 0 < abs(a - b) <= near)

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

    @property
    def smoothing_speeds(self) -> tuple[float, ...]:
        """Speed of each joint over which `derivative` smooths the sign of dry friction [rad/s or m/s].

        There a joint that friction holds creeps at up to this speed: choose one at which it moves by less than its
        sensor's noise while it sticks. Simulations along a log know no such speed: joints stick in them.
        """
        return tuple(SMOOTHING[u] for u in self._kinds)
