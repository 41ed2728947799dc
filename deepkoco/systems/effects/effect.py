"""What an effect is: a nested extension of a system at one place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.joint_state import JointState, Memory
from deepkoco.systems.named_joints import COMMON
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

Place = Literal["command", "series", "timing", "load", "memory", "body", "elastic", "sensor", "noise"]
Site = Literal[
    "system", "joint", "command", "channel", "kind", "body", "place", "force place", "pair", "shown pair"
]
PAIRS = ("pair", "shown pair")

ALL = -1  # index of an effect that acts on all driving commands alike


def steady_level(effect: Effect, p: Parameters) -> Tensor:
    """Level of dry friction that depends on the effect's own parameters alone."""
    assert effect.level is not None
    assert effect.steady
    nothing = torch.zeros((), dtype=torch.float64)
    return effect.level(JointState(nothing, nothing, nothing, None, 1.0), p)


class SensorSite(NamedTuple):
    """Which channels a sensor effect acts on, and when.

    Attributes:
        positions: Channels of the joint's position.
        speeds: Channels of its speed.
        time: Since the log's first command [s], of the shape of one channel.
        others: Of a pair, the channels of the other joint's position, and those of its speed.
    """

    positions: tuple[int, ...]
    speeds: tuple[int, ...]
    time: Tensor | None
    others: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())


def _carried_out_elsewhere(*_: Any) -> Any:
    raise TypeError("an effect in time, or on the noise, has no equation to apply")


def _all_of(p: Parameters) -> Parameters:
    # A module's function, not a lambda: systems travel between processes.
    return p


@dataclass(frozen=True)
class Effect:
    """Extra physics whose parameters have null values that recover the system without it exactly.

    Attributes:
        name: Name of the effect.
        family: Group it is reported in: timing, friction, actuator, sensor or body.
        place: Where it acts, which fixes the signature of ``apply`` (``p`` holds this effect's own
            parameters by their short names, each scalar or of the batch shape):

            - ``command``: ``apply(command, p) -> effort``, memoryless;
            - ``series``: ``apply(commands (n, ...), t (n,), p) -> efforts``: the log of one command, where the
              effort depends on the past or on the time since the log began;
            - ``load``: ``apply(joint: JointState, p) -> load`` on the joint [N m or N]; of a joint's state an effect
              may read the attributes only;
            - ``memory``: ``apply(joint: JointState, value, p) -> load``: a load that depends on what the effect
              remembers of the way of the joint, see :class:`Memory`; it acts along a log only;
            - ``body``: ``apply(system, joint, parameters, p) -> parameters``;
            - ``elastic``: no ``apply``; an :class:`ElasticDrive` has its equations and the states that it adds;
            - ``sensor``: ``apply(measurement (..., N), site: SensorSite, p) -> measurement``;
            - ``timing``: no ``apply``; the simulator carries it out;
            - ``noise``: no ``apply``; it changes what is random, not what is expected.
        parameters: ``(system, index)`` -> parameters at one site; their ``value`` is the null value. Empty where
            the effect makes no sense there.
        summary: One sentence for reports.
        apply: The physics.
        site: What the effect belongs to: there is one for each joint, command, channel, kind of parameters, body with
            a mass, place of a payload (the tip first), place of an outside force, pair of coupled joints, or pair of
            joints whose positions are measured, or one in all. A load of a pair acts on the second joint and is shown
            the state of the second joint with the effort of the first.
        shared: Whether there is one more, ``<name>(all)``, that acts on all driving commands alike.
        acting: ``(p) -> p``: its own parameters without those that change nothing at their present values. It is asked
            once before many calls of ``apply``.
        level: Of dry friction, ``level(joint: JointState, p) -> level`` [N m or N]: its size, which is the largest load
            at which it holds a joint at rest. ``apply`` is then the load of this size against a smoothed direction.
        steady: Whether ``level`` depends on the parameters alone.
        memory: Of an effect with a memory, how its value begins and changes.
    """

    name: str
    family: str
    place: Place
    parameters: Callable[..., tuple[Parameter, ...]]
    summary: str
    apply: Callable[..., Any] = _carried_out_elsewhere
    site: Site = "joint"
    acting: Callable[[Parameters], Parameters] = _all_of
    level: Callable[[JointState, Parameters], Tensor] | None = None
    steady: bool = False
    memory: Memory | None = None
    shared: bool = False

    @property
    def dry(self) -> bool:
        """Whether it is dry friction, which changes its sign with the speed and lets a joint stick."""
        return self.level is not None


class PlacedEffect(NamedTuple):
    """An effect at one site of a system; its parameters are called ``<name>.<parameter>``."""

    name: str
    effect: Effect
    index: int

    def acts_on(self, command: int, system: System) -> bool:
        """Whether an effect on commands acts on this one; commands that only switch something are never meant."""
        return command == self.index or (self.index == ALL and command < len(system.command_joints))

    def joint(self, system: System) -> int:
        """Joint on which a load acts."""
        return self._pair(system)[1] if self.effect.site in PAIRS else self.index

    def source(self, system: System) -> int:
        """Joint whose effort, or whose measurement, it is shown."""
        return self._pair(system)[0] if self.effect.site in PAIRS else self.index

    def _pair(self, system: System) -> tuple[int, int]:
        pairs = system.coupled_joints if self.effect.site == "pair" else system.shown_pairs
        return pairs[self.index]

    def parameters(self, system: System) -> tuple[Parameter, ...]:
        """Declarations under their short names."""
        return self.effect.parameters(system, self.index)


def parameter_kinds(system: System) -> dict[str, tuple[str, ...]]:
    """Kinds of parameters that several joints or actuators have, ``kp`` of ``kp(elbow)``, with their full names.

    All of a kind have one unit and positive values; else a common factor would make no sense.
    """
    kinds: dict[str, list[Parameter]] = {}
    owners = {*system.joint_names, *(c.name for c in system.commands)}
    for p in system.parameters:
        kind, _, owner = p.name.partition("(")
        if owner.endswith(")") and owner[:-1] in owners:
            kinds.setdefault(kind, []).append(p)
    return {
        kind: tuple(p.name for p in own)
        for kind, own in kinds.items()
        if len(own) > 1 and len({p.unit for p in own}) == 1 and min(p.value for p in own) > 0.0
    }


def place(effect: Effect, system: System) -> tuple[PlacedEffect, ...]:
    """The effect at every site of a system where it makes sense.

    A joint, or that of a command, is named where there are several: ``coulomb``, or ``coulomb(joint 2)``; a channel
    is always named: ``noise_level(theta)``. What several actuators may have in common has one more site, ``all``.
    """
    if effect.site == "system":
        names = [effect.name]
    elif effect.site in PAIRS:
        system.at_joint(effect.name, 0)  # refuses names that cannot be read back
        joints = system.joint_names
        pairs = system.coupled_joints if effect.site == "pair" else system.shown_pairs
        names = [f"{effect.name}({joints[a]} to {joints[b]})" for a, b in pairs]
    elif effect.site == "place":
        # The tip is a site too, but has its own, shorter name already.
        own = ["" if site == system.tip else f"{effect.name}({site})" for site in system.payload_sites]
        names = [effect.name, *own]
    elif effect.site == "force place":
        names = [f"{effect.name}({site})" for site in system.force_sites]
    elif effect.site == "kind":
        names = [f"{effect.name}({kind})" for kind in parameter_kinds(system)]
    elif effect.site == "body":
        names = [f"{effect.name}({body})" for body in system.bodies]
    elif effect.site == "channel":
        names = [f"{effect.name}({c.name})" for c in system.measurements]
    else:
        at, sites = system.at_joint, system.own_joints
        if effect.site == "command":
            at, sites = system.at_command, len(system.command_joints)
        names = [at(effect.name, k) for k in range(sites)]
    placed = [PlacedEffect(name, effect, i) for i, name in enumerate(names) if name]
    if effect.place == "load":
        placed = [p for p in placed if p.joint(system) in system.loaded_joints]
    several = len(system.command_joints) > 1 and COMMON not in system.joint_names
    if effect.shared and several:
        placed.append(PlacedEffect(f"{effect.name}({COMMON})", effect, ALL))
    return tuple(p for p in placed if p.parameters(system))
