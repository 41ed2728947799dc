"""Whether logs are of a machine, or of a simulation by an engine, and in which steps.

A joint of a real robot sticks, and commands act when they arrive. In MuJoCo a joint under load creeps below its
``frictionloss``, and commands act half a step early: a good encoder shows both. There a log of a healthy simulated
robot has a friction and a delay that no machine has, and which the catalogue would name. The logs decide: a simulation
is that of the engine where a refit with it leaves less. Whoever made the logs may have taken other steps than those of
the file. What the engine does early or late is a share of its step, so a parabola through three steps tells the step.
An engine of rigid bodies has such steps too, with a friction that holds; they leave only noise of its logs. A hidden
cause, such as a delay of commands, may decide wrongly there; so the question is asked once more beside the causes that
were found (:mod:`deepkoco.diagnose.the_other_way`).
Semi-implicit steps that are short beside those of a machine do what it does, but for commands that act half a step
early and speeds that are half a step late (they are leapfrog steps). Then the machine simulates the logs, with commands
that are early: in steps of 0.2 ms each simulation of a log takes ten times as long.
Where more than noise is left, it is asked at once beside a delay of all commands, too, which hides that an engine has
them early.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from deepkoco.diagnose.baseline import Baseline, Near
from deepkoco.diagnose.left_of_logs import FAR, LESS, NOISE, Left, LeftOfLogs
from deepkoco.fit.data.own_steps import nearest_own_step
from deepkoco.fit.data.windows import cut_windows, estimate_channels, moving
from deepkoco.fit.solve.lazy_batch import MANY
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.recording import Recording
from deepkoco.systems import System
from deepkoco.systems.engine_names import MUJOCO, SEMI_IMPLICIT

SOME, FEW = 16, 6  # windows that decide, and those that do where a fit has many parameters
# Noise variances that a simulation by the engine leaves of its own logs at most. A real robot that its file describes
# badly leaves hundreds with either law, and which of two refits ends lower says nothing of friction.
NEAR = 10.0
# Share that a delay of all commands leaves, where it hides the steps of an engine, and the engine beside it of that.
LATE = 0.1
# Share of the machine's usual step up to which steps of an engine are short. Noise variances that the machine with
# early commands leaves of them at most: where a joint turns, an engine's friction acts for a whole step, and logs hold
# what no simulation explains.
SHORT, AS_MACHINE = 0.125, 2.0
LONGEST = 4.0  # step that a parabola may lead to, over the longest of its three
SHARES = (0.5, 0.125)  # of the usual step, which are tried first
DIGITS = 2  # of a step that is found
PARABOLAS = 5  # in turn, where nobody stated a step
SAME = 0.02  # relative difference of steps that logs hardly tell

log = logging.getLogger(__name__)

S = TypeVar("S", bound=System)


def as_engine_if_shown(
    recordings: Sequence[Recording], system: System, length: float, learned: Baseline | None = None
) -> System:
    """Return the system as the engine of its file simulates it, where that follows the logs better; else itself.

    Args:
        recordings: Logs.
        system: The system.
        length: Of the windows [s].
        learned: Baseline from healthy logs, which have decided; None for none.
    """
    if learned is not None and system.engine is None and system.engines:
        of_learned = learned.system
        own = system.with_engine(of_learned.engine, of_learned.engine_step)
        return system if own is None else own
    return closest_of_logs(recordings, system, length).system


class Closest(NamedTuple):
    """What simulates logs best.

    Attributes:
        system: The system, as a machine or as an engine simulates it.
        left: What it leaves of some windows; None where nothing was asked.
        near: What the fits of these windows tell of further ones; None where nothing was asked.
        on_time: The system by the law that leaves least of those that have commands when they are logged, or later;
            None where nothing was asked.
        early: Whether early commands matter: this law leaves more than noise, or clearly more than what was found.
        lead: Time by which commands act before their rows in it [s].
    """

    system: System
    left: Left | None = None
    near: Near | None = None
    on_time: System | None = None
    early: bool = False
    lead: float = 0.0


def closest_of_logs(
    recordings: Sequence[Recording], system: System, length: float, near: Near | None = None
) -> Closest:
    """Return the system as the engine of its file simulates it, or itself: the one that follows the logs better.

    Args:
        recordings: Logs.
        system: The system.
        length: Of the windows [s].
        near: What earlier fits of the logs have told; None for none.
    """
    if system.engine is not None or not system.engines:
        return Closest(system)  # a file says that it is of an engine, or there is none
    windows = cut_windows(recordings, system, length, estimate_channels(recordings, system))
    windows = windows.take(moving(windows)) if len(windows) else windows
    if len(windows) == 0:
        return Closest(system)
    many = len(system.parameters) + windows.state.shape[1] >= MANY
    windows = windows.take(np.unique(np.linspace(0, len(windows) - 1, FEW if many else SOME).astype(int)))
    left, nearest = LeftOfLogs(windows, near), partial(nearest_own_step, windows)
    try:
        held = left(system)
        if len(quiet := left.undisturbed()) < len(windows):
            left = LeftOfLogs(quiet, left.near(system, held), left.logged)
            held = left(system)
        if (
            left.noise < held.per_sample <= FAR
            and (as_machine := _of_short_steps(system, left, held)) is not None
            and _explains_as_much(as_machine, system, left, held, nearest)
        ):
            return as_machine
        law, leaves = closest(system, left, nearest, held=held, noise=left.noise)
    except DivergedError:
        return Closest(system)
    if leaves.per_sample <= left.noise:
        return _closest(law, leaves, leaves, left)
    told = leaves
    with contextlib.suppress(DivergedError):
        # Late commands hide that an engine has them early.
        late = left.late(system, held)
        if _matters(late, held) or _creeps_late(system, left, late):
            other, leaves_late = closest(system, left.late, nearest, NEAR, late, left.noise)
            plainly = leaves_late.per_sample <= NOISE or leaves_late.cost <= LATE * late.cost
            told = late if _matters(late, held) else leaves
            if other.engine is not None and plainly:
                law, leaves, told = other, leaves_late, leaves_late
    return _closest(law, leaves, told, left)


def _matters(late: Left, than: Left) -> bool:
    """Return whether a delay of all commands leaves so little of logs that a simulation beside it may be theirs."""
    return late.less_than(than) and (late.per_sample <= NEAR or late.cost <= LATE * than.cost)


def _creeps_late(machine: System, left: LeftOfLogs, late: Left) -> bool:
    """Return whether friction that creeps, beside a delay of all commands, leaves little of what the delay leaves.

    Each hides the other: a machine left 339 noise variances of an arm whose engine had its commands 2 ms late, friction
    that creeps left 174, the delay 116, and both together 1.5.
    """
    return MUJOCO in machine.engines and _matters(left.late(_in_steps(machine, MUJOCO, 0.0), late), late)


def _of_short_steps(machine: System, left: LeftOfLogs, held: Left) -> Closest | None:
    """Return the machine with commands that are early by half a short step of an engine, where this is what logs show.

    Args:
        machine: The system.
        left: Which is asked.
        held: What the machine leaves with commands from their rows on.
    """
    with contextlib.suppress(DivergedError):
        early = left.early(machine)
        log.debug("%s: early %s", machine.name, early)
        if early is None or 2.0 * early.lead > SHORT * left.windows.step:
            return None
        if early.left.per_sample <= AS_MACHINE and early.left.less_than(held):
            near = left.near(machine, early.left, early.lead)
            return Closest(machine, early.left, near, lead=early.lead)
    return None


def _explains_as_much(
    as_machine: Closest, machine: System, left: LeftOfLogs, held: Left, nearest: Callable[[float], float]
) -> bool:
    """Return whether the machine with early commands leaves only noise, or no more than the engine of its file.

    Friction that creeps is none of a machine, however short the steps. Friction that holds in short steps is that of a
    machine, so engines of rigid bodies are not asked.

    Args:
        as_machine: What was found.
        machine, left, held: As for :func:`_of_short_steps`.
        nearest: As for :func:`closest`.
    """
    assert as_machine.left is not None
    if as_machine.left.per_sample <= left.noise or MUJOCO not in machine.engines:
        return True
    with contextlib.suppress(DivergedError):  # what runs away explains nothing
        return not _as_in_file(machine, left, held, NEAR, nearest)[0].less_than(as_machine.left)
    return True


def _closest(law: System, leaves: Left, told: Left, left: LeftOfLogs) -> Closest:
    """Return what was found.

    Args:
        law: The system.
        leaves: What it leaves.
        told: What it leaves where that is known better, beside a delay of all commands.
        left: Which was asked.
    """
    on_time = left.on_time
    if on_time is None:
        return Closest(law, leaves, left.near(law, told))
    early = on_time.left.per_sample > left.noise or told.less_than(on_time.left)
    return Closest(law, leaves, left.near(law, told), on_time.law, early)


def closest(
    machine: S,
    left: Callable[[S], Left],
    nearest: Callable[[float], float] = lambda step: step,
    near: float = NEAR,
    held: Left | None = None,
    noise: float = NOISE,
) -> tuple[S, Left]:
    """Return the machine, or its simulation by an engine in the steps that leave least of logs, and what it leaves.

    Args:
        machine: Simulated as a machine; it has engines.
        left: What a simulation leaves of the logs.
        nearest: Step [s] -> the nearest one that an engine which these logs command can have.
        near: Noise variances that a simulation as by the engine of the file leaves at most.
        held: What the machine leaves, where that is known.
        noise: Noise variances that any simulation leaves of its own logs at most.

    Raises:
        DivergedError: A simulation diverges.
    """
    held = left(machine) if held is None else held
    own, found = held, machine
    if MUJOCO in machine.engines:
        own, found = _as_in_file(machine, left, held, near, nearest)
    if SEMI_IMPLICIT in machine.engines and noise < own.per_sample <= FAR:
        with contextlib.suppress(DivergedError):
            again, rigid = _as_rigid(machine, left, held, nearest, None if found is machine else own)
            # The logs choose the steps, too, which a bad model could use; so they have to leave only noise.
            if again.per_sample <= noise and again.less_than(own):
                return rigid, again
    return found, own


def _as_in_file(
    machine: S, left: Callable[[S], Left], held: Left, near: float, nearest: Callable[[float], float]
) -> tuple[Left, S]:
    """What is left and its system: the machine, or its simulation by the engine of its file where that is closer."""
    of_file = machine.with_engine(MUJOCO)
    assert of_file is not None
    assert of_file.engine_step is not None
    best, simulated = left(of_file), of_file
    log.debug("%s: %s as a machine, %s as in %s", machine.name, held, best, of_file.engine)
    # Steps of 2 ms for 0.5 ms can leave only noise here, and look like a filter of the sensors and lost commands. A
    # machine can leave only noise of steps of 0.5 ms, too, and less than steps of 2 ms do.
    if min(best.per_sample, held.per_sample) <= FAR:
        step = of_file.engine_step
        with contextlib.suppress(DivergedError):  # the step of the file then stands
            costs = {step: best.cost}
            for share in (0.5, 0.0):
                costs[share * step] = left(_in_steps(machine, MUJOCO, share * step)).cost
            # Of steps of 0.49 ms for 0.5 ms, thirty noise variances were left that looked like a little of any cause.
            other = _in_steps(machine, MUJOCO, nearest(_least(costs)))
            again = left(other)
            log.debug("%s: %s in steps of %.3g s, costs %s", machine.name, again, other.engine_step, costs)
            if again.less_than(best):
                simulated, best = other, again
    is_close = best.per_sample <= near and best.less_than(held)
    return (best, simulated) if is_close else (held, machine)


def _as_rigid(
    machine: S,
    left: Callable[[S], Left],
    held: Left,
    nearest: Callable[[float], float],
    than: Left | None = None,
) -> tuple[Left, S]:
    """What is left in semi-implicit steps of the best length, and their system; a step of 0 is the machine.

    Args:
        machine, left, held, nearest: As for :func:`closest`.
        than: What another engine leaves: steps that promise no less are not searched for further. None for none.

    Raises:
        DivergedError: A simulation diverges.
    """
    usual = machine.with_engine(SEMI_IMPLICIT)
    assert usual is not None
    assert usual.engine_step is not None
    systems, found = {0.0: machine}, {0.0: held}

    def ask(step: float) -> bool:
        """Whether a step leaves less of the logs than the machine does."""
        step = nearest(step)
        systems[step] = _in_steps(machine, SEMI_IMPLICIT, step)
        found[step] = left(systems[step])
        return found[step].cost < held.cost

    # A loop that logs every step of its engine is the usual one. Else twice the best step is as bad as the machine, and
    # longer ones are worse.
    wanted, longest = usual.engine_step, nearest(math.inf)
    with contextlib.suppress(DivergedError):
        if math.isfinite(longest) and ask(longest):
            wanted = 0.5 * longest
    if wanted == usual.engine_step and not any(ask(share * usual.engine_step) for share in SHARES):
        return held, machine
    if len(found) > 2:
        wanted = _least({h: own.cost for h, own in found.items()})
    # A parabola from 0 to 1 ms tells 4 ms roughly, and the next ones better.
    for _ in range(PARABOLAS):
        wanted = nearest(wanted)
        if any(abs(wanted - step) <= SAME * step for step in found):
            break
        if than is not None and len(found) > 2 and _promised(found, wanted) >= than.cost:
            return held, machine
        guessed, before = len(found) > 2, _best(found)
        try:
            ask(wanted)
        except DivergedError:
            break
        if guessed and not _comes_near(_best(found), before):
            return held, machine
        near = sorted(found, key=lambda step: found[step].cost)[:3]
        wanted = _least({step: found[step].cost for step in near})
    if _best(found).per_sample > NEAR:
        return held, machine
    # The machine need not lie on the parabola: its friction holds, and its fit may have ended elsewhere. Steps of 1 ms
    # then stood for 0.5 ms beside a delay, and what they left looked like lost commands.
    with contextlib.suppress(DivergedError):
        while (shortest := min(_steps_of(found))) == _best_step(found):
            shorter = nearest(0.5 * shortest)
            if shortest - shorter <= SAME * shortest:
                break
            ask(shorter)
        if len(_steps_of(found)) > 2:
            near = sorted(_steps_of(found), key=lambda step: found[step].cost)[:3]
            wanted = nearest(_least({step: found[step].cost for step in near}))
            if all(abs(wanted - step) > SAME * step for step in found):
                ask(wanted)
    # Each fit started at the parameters of another step, which may be far. A step may have led to parameters that the
    # machine's own fit had missed.
    found[0.0] = min(held, left(machine), key=lambda own: own.cost)
    for step in sorted(found, key=lambda step: found[step].cost)[:2]:
        found[step] = min(found[step], left(systems[step]), key=lambda own: own.cost)
    best = min(found, key=lambda step: found[step].cost)
    log.debug("%s: in semi-implicit steps %s", machine.name, found)
    return found[best], systems[best]


def _best(found: Mapping[float, Left]) -> Left:
    return min(found.values(), key=lambda own: own.cost)


def _steps_of(found: Mapping[float, Left]) -> list[float]:
    """Steps of an engine that were asked for, without the machine."""
    return [step for step in found if step > 0.0]


def _best_step(found: Mapping[float, Left]) -> float:
    return min(_steps_of(found), key=lambda step: found[step].cost)


def _comes_near(now: Left, before: Left) -> bool:
    """Whether a better guess of the steps leaves so much less that these may be the steps of the logs.

    What is left grows with the square of the distance from these.
    """
    return now.per_sample <= NEAR or now.cost <= LESS * before.cost


def _in_steps(machine: S, name: str, step: float) -> S:
    simulated = machine.with_engine(name, step)
    assert simulated is not None
    return simulated


def _promised(found: Mapping[float, Left], step: float) -> float:
    """Return the cost of a step on a parabola through the three best ones."""
    near = sorted(found, key=lambda each: found[each].cost)[:3]
    return float(np.polyval(np.polyfit(near, [found[each].cost for each in near], 2), step))


def _least(costs: Mapping[float, float]) -> float:
    """Return the step at which a parabola through three costs is least."""
    curvature, slope, _ = np.polyfit(list(costs), list(costs.values()), 2)
    longest = LONGEST * max(costs)
    best = -0.5 * slope / curvature if curvature > 0.0 else min(costs, key=lambda step: costs[step])
    return float(f"{min(max(float(best), 0.0), longest):.{DIGITS}g}")
