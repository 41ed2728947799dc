"""Type of a cause: an extension of the baseline, with its start values, its signature and its texts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from deepkoco.diagnose.causes.tolerance import Tolerance, share_of_usual
from deepkoco.systems import Parameter, System
from deepkoco.systems.effects import PlacedEffect
from deepkoco.systems.effects.effect import ALL, PAIRS
from deepkoco.systems.motion import PushPlace

if TYPE_CHECKING:
    from deepkoco.diagnose.residuals.residuals import MissingTorque
    from deepkoco.diagnose.residuals.scatter import Scatter, Verdict


class Motion(NamedTuple):
    """Motion and command of one joint, sampled over time; all (n,)."""

    time: np.ndarray  # [s]
    theta: np.ndarray  # [rad or m]
    omega: np.ndarray  # per second
    command: np.ndarray  # command's unit
    command_rate: np.ndarray  # per second


class Hint(NamedTuple):
    """Data from which a cause chooses its start values, at one joint or command."""

    system: System
    joint: int
    command: np.ndarray  # (n,) command values of the logs
    omega: np.ndarray  # first guess of speeds, per second
    pushes: tuple[Mapping[str, float], ...]  # when and where an outside load lowers chi2 most
    seconds: float  # length of the logs [s]
    chi2: float  # chi2 per sample of the refitted baseline
    missing: MissingTorque | None  # missing load of the refitted baseline at this joint
    strained: bool = False  # whether the refitted baseline is far from its prior
    interval: float = 0.0  # time from one command to the next [s]
    shifts: tuple[Mapping[str, float], ...] = ()  # when a moved zero of the joint's sensor lowers chi2 most


Axis = Literal["omega", "theta", "command", "time", "command_rate"]
Starts = Callable[[Hint], list[dict[str, float]]]


def from_null(hint: Hint) -> list[dict[str, float]]:
    """Return one start: the null value."""
    return [{}]


@dataclass(frozen=True)
class Cause:
    """One entry of the catalogue; :func:`deepkoco.diagnose.causes.catalogue` puts it at every site of a system.

    Attributes:
        name: Name in reports: the name of its effect, with the joint where there are several.
        family: Group of similar causes.
        free: Parameters of the effect that a fit frees; short names here, full names once the cause is placed.
        summary: One sentence for the report.
        advice: Experiment that distinguishes it from similar causes.
        axis: Quantity against which the missing load shows it best.
        signature: Motion -> shape (n,) of the missing load under a small dose of it.
        starts: Start values by short names; several where the gradient vanishes at null or the cost has several
            minima.
        counted: Number of parameters that the penalty counts; None counts all.
        states: Number of initial states that count with it alone, of all windows, which the penalty charges.
        searched: Whether it was searched for at many places in time, which the penalty charges.
        choices: Number of discrete values that were tried, which the penalty charges.
        valley: Values -> other values along a valley of the cost, by full names; None where there is none.
        also: Parameters that a fit frees too at sites where the effect has them.
        also_summary: The sentence for the report at these sites.
        scatter: Test of a noise cause; None for other causes.
        traced: Whether it is searched for in the data itself (`lost_commands.search`), not by fits of parameters.
        shape: Those of ``free`` that say where, when or in which form it acts, and not how much of it there is.
        natural: Those of ``shape`` that often have their declared value, not just any: a spring is at rest at the
            zero of its joint, and has one parameter less then.
        relative: ``(system, channel)`` -> channels that have none of it, where one shows it only beside one of these;
            None where its own shows it alone.
        several: ``(system)`` -> channels that all have it; a log that measures one of them alone shows the cause of
            that channel in its place. None where it belongs to no group of channels.
        regroups: Whether it is one factor on parameters that a refit frees: it adds nothing beside them, and is asked
            for only in the place of many of them, or by its name.
        tolerance: How much of every other parameter any healthy machine has, as a distance from the null value.
        effect: Name of the placed effect that simulates it; "event" for a push, "changed" for a parameter itself.
        beside: Names of the channels that have none of it, once it is placed.
        among: Names of the channels that all have it, once it is placed.
        joint: Joint on which it acts; None for the whole system, or for all actuators alike.
        index: Index of its command or channel, where it belongs to one.
    """

    name: str
    family: str
    free: tuple[str, ...]
    summary: str
    advice: str
    axis: Axis
    signature: Callable[[Motion], np.ndarray]
    starts: Starts = from_null
    counted: int | None = None
    states: int = 0
    searched: bool = False
    choices: int = 1
    valley: Callable[[Mapping[str, float]], list[dict[str, float]]] | None = None
    scatter: Callable[[Scatter, int], Verdict | None] | None = None
    traced: bool = False
    shape: tuple[str, ...] = ()
    natural: tuple[str, ...] = ()
    relative: Callable[[System, int], tuple[int, ...]] | None = None
    several: Callable[[System], tuple[int, ...]] | None = None
    tolerance: Tolerance = share_of_usual
    regroups: bool = False
    also: tuple[str, ...] = ()
    also_summary: str = ""
    effect: str = ""
    beside: tuple[str, ...] = ()
    among: tuple[str, ...] = ()
    joint: int | None = None
    index: int = 0

    @property
    def kind(self) -> str:
        """Name in the registry."""
        return kind_of(self.name)

    @property
    def sizes(self) -> tuple[str, ...]:
        """Full names of the free parameters that say how much of it there is."""
        return tuple(n for n in self.free if n.rpartition(".")[2] not in self.shape)

    @property
    def naturals(self) -> tuple[str, ...]:
        """Full names of the free parameters that often have their declared value."""
        return tuple(n for n in self.free if n.rpartition(".")[2] in self.natural)

    @property
    def size(self) -> int:
        """Number of parameters that the penalty counts."""
        return (len(self.free) if self.counted is None else self.counted) + self.states

    def at(self, placed: PlacedEffect, system: System) -> Cause:
        """The cause at one site of a system."""
        site = placed.effect.site
        joint = placed.joint(system) if site in ("joint", *PAIRS) else None
        if site == "command" and placed.index != ALL:
            joint = system.command_joints[placed.index]
        parameters = placed.parameters(system)
        declared = [p.name for p in parameters]
        # If the effect has other parameters on this system (a tilt in a plane has two), all of them are freed.
        same = all(n in declared for n in self.free)
        cause = self if same else replace(self, free=tuple(declared))
        if more := tuple(n for n in self.also if same and n in declared):
            cause = replace(self, free=(*self.free, *more), summary=self.also_summary or self.summary)
            beside = [p for p in parameters if p.name in more]
            cause = replace(cause, starts=lambda hint: [*self.starts(hint), *_beside(self.free, beside)])
        if self.relative is not None:
            others = self.relative(system, placed.index)
            cause = replace(cause, beside=tuple(system.measurements[c].name for c in others))
        if self.several is not None:
            cause = replace(cause, among=tuple(system.measurements[c].name for c in self.several(system)))
        return cause._called(placed.name, placed.name, joint, placed.index)

    def on_joint(self, joint: int, system: System) -> Cause:
        """A cause without an effect (a push) on one joint."""
        return self._called(system.at_joint(self.name, joint), self.name, joint, joint)

    def on_body(self, index: int, place: PushPlace) -> Cause:
        """A push of a body: one of the places of a system, and its number among them."""
        shown = {p.name for p in place.parameters} | {"start", "duration"}
        cause = replace(self, free=tuple(n for n in self.free if n in shown))
        return cause._called(f"{self.name}({place.body})", "event", place.joint, index)

    def _called(self, name: str, effect: str, joint: int | None, index: int) -> Cause:
        chosen = self.starts

        def starts(hint: Hint) -> list[dict[str, float]]:
            return [{f"{effect}.{k}": v for k, v in place.items()} for place in chosen(hint)]

        free = tuple(f"{effect}.{n}" for n in self.free)
        return replace(self, name=name, effect=effect, free=free, starts=starts, joint=joint, index=index)


def _beside(sizes: Sequence[str], shapes: Sequence[Parameter]) -> list[dict[str, float]]:
    """Return starts that choose a shape to both sides of its declared value and leave the sizes at null.

    A load at the middle of a link moves its mass, one at the end its static moment too: other motions, and the first
    tells nothing of the second.

    Args:
        sizes: Parameters that are 0 where there is nothing.
        shapes: Parameters that only say where it is.
    """
    none = dict.fromkeys(sizes, 0.0)
    at = [(p.name, min(max(p.value + side * p.prior_sd, p.low), p.high)) for p in shapes for side in (1, -1)]
    return [{**none, name: value} for name, value in at]


def kind_of(name: str) -> str:
    """Name of a cause in the registry: ``coulomb`` for ``coulomb(joint 2)``."""
    return name.split("(")[0]
