"""Simulation of windows and lanes by the bytecode of a system: which effects act where, and whether it is right."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from threading import RLock
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.simulate.bytecode.program import Program, TraceError, program_of
from deepkoco.fit.simulate.equations import equations_of
from deepkoco.fit.simulate.nodes import Nodes
from deepkoco.fit.simulate.torch_steps import StepsInput, first_memory, in_torch
from deepkoco.systems import ExtendedSystem, System
from deepkoco.systems.plain import is_plain

CHECKED = 2  # steps of a new program that are compared with torch
LANES = 3  # in which they are
TIMES = (0.0, 1.3, 47.0)  # log times of the windows in which they are [s]
SHORT = 2e-3  # length of these steps where programs suit any [s]
BROAD = 1e3  # largest command there
SAME = 1e-9  # relative difference up to which both are the same
FAR = 1e4  # state from which a motion there is no longer moderate
WEAKER, WEAKENED = (
    0.1,
    9,
)  # factor on the drive and the effects of a lane with such a motion, and number of trials

PLACES = ("body", "load", "memory", "elastic")  # of effects that are part of the equations of motion
# States (2 J, n + 1, W, L), and accelerations (J, n, W, L) at the start and at the end of each step.
Rolled = tuple[np.ndarray, np.ndarray, np.ndarray]
Key = tuple[tuple[str, ...], tuple[str, ...], float | None, bool]
_programs: WeakKeyDictionary[System, dict[Key, Program | None]] = WeakKeyDictionary()
_parts: WeakKeyDictionary[System, dict[tuple[str, ...], ExtendedSystem]] = WeakKeyDictionary()
_filling = RLock()  # several threads simulate, and a trace changes how torch works


def along_windows(
    system: System,
    values: Mapping[str, Tensor],
    lanes: Mapping[str, slice] | None,
    given: StepsInput,
) -> Nodes | None:
    """Simulate by bytecode; None where no lane's equations can be traced, or where gradients are wanted.

    Lanes with the same effects are simulated together, under a program with these effects alone.

    Args:
        system: Dynamics.
        values: Named values in the units of the system, each scalar, (L,), (W, 1) or (W, L).
        lanes: Effect -> lanes in which it acts; None for all.
        given: Start and drive.

    Returns:
        States (n + 1, W, L) and their derivatives (n, W, L) at both ends of each step.

    Source: as for :func:`deepkoco.fit.simulate.step.step_of`.
    """
    tensors = [torch.as_tensor(v) for v in values.values()]
    loads = [] if given.loads is None else [given.loads]
    if not is_plain([*tensors, *given.start, *given.begin, *given.slope, *loads]):
        return None
    windows, count = given.start[0].shape
    steps, joints = len(given.begin[0]) // given.pieces, system.joints
    groups = []
    inside = _in_equations(system)
    lanes = {name: part for name, part in (lanes or {}).items() if name in inside}
    for first, last in _groups(lanes, count, given):
        acting = _with_effects(
            system, [n for n in inside if n not in lanes or first in range(*lanes[n].indices(count))]
        )
        own = {n: v for n, v in values.items() if "." not in n or n.partition(".")[0] in _names(acting)}
        own = {n: torch.as_tensor(v) for n, v in own.items()}
        part = _of_lanes(given, first, last)
        own = {n: v[..., first:last] if v.ndim and v.shape[-1] == count else v for n, v in own.items()}
        groups.append((first, last, acting, own, part, _known(acting, own, part)))
    if all(program is None for *_, program in groups):
        return None
    value = np.empty((2 * joints, steps + 1, windows, count))
    ends = np.empty((2, joints, steps, windows, count))
    for first, last, acting, own, part, program in groups:
        # An effect that cannot be traced makes the lanes of no other slow.
        found = _in_torch(acting, own, part) if program is None else _run(acting, own, part, program)
        value[..., first:last], ends[0, ..., first:last], ends[1, ..., first:last] = found
    states = torch.from_numpy(value).unbind(0)
    fast = states[joints:]
    return Nodes(
        states,
        (*(v[:-1] for v in fast), *torch.from_numpy(ends[0]).unbind(0)),
        (*(v[1:] for v in fast), *torch.from_numpy(ends[1]).unbind(0)),
    )


def _names(system: System) -> tuple[str, ...]:
    return tuple(e.name for e in system.effects) if isinstance(system, ExtendedSystem) else ()


def _groups(lanes: Mapping[str, slice], count: int, given: StepsInput) -> list[tuple[int, int]]:
    """Neighbouring lanes in which the same effects act, with steps in one piece or with others.

    Returns:
        The first lane of each group, and the one behind its last.
    """
    edges = {0, count, *(e for part in lanes.values() for e in (part.start, part.stop))}
    if given.length is not None:
        in_pieces = (given.length.unflatten(0, (-1, given.pieces))[:, 1:] > 0.0).any(0).any(0).any(0)
        edges.update((in_pieces[1:] != in_pieces[:-1]).nonzero()[:, 0].add(1).tolist())
    return list(itertools.pairwise(sorted(edges)))


def _in_equations(system: System) -> tuple[str, ...]:
    """Effects that are part of the equations; the others change commands, times or measurements."""
    if not isinstance(system, ExtendedSystem):
        return ()
    return tuple(e.name for e in system.effects if e.effect.place in PLACES)


def _with_effects(system: System, names: Sequence[str]) -> System:
    """The system with some of its effects alone."""
    if not isinstance(system, ExtendedSystem):
        return system
    key = tuple(names)
    with _filling:
        known = _parts.setdefault(system, {})  # not by the base, to which the parts refer
        if key not in known:
            known[key] = ExtendedSystem(system.base, key)
        return known[key]


def _of_lanes(given: StepsInput, first: int, last: int) -> StepsInput:
    def cut(x: Tensor) -> Tensor:
        return x[..., first:last]

    part = given._replace(
        start=tuple(cut(x) for x in given.start),
        begin=tuple(cut(x) for x in given.begin),
        slope=tuple(cut(x) for x in given.slope),
        loads=None if given.loads is None else cut(given.loads),
    )
    if given.length is None:
        return part
    length, pieces = cut(given.length), given.pieces
    if bool((length.unflatten(0, (-1, pieces))[:, 1:] > 0.0).any()):
        return part._replace(length=length)
    begin, slope = (tuple(x[::pieces] for x in each) for each in (part.begin, part.slope))
    return part._replace(begin=begin, slope=slope, length=None, pieces=1)


def has_program(system: System, step: float | None) -> bool:
    """Whether the equations of a system can be traced, for an integration step [s] or for steps of any length."""
    return _program(system, [p.name for p in system.parameters], step, False) is not None


def _known(system: System, values: Mapping[str, Tensor], given: StepsInput) -> Program | None:
    return _program(system, values, None if given.length is not None else given.step, given.loads is not None)


def _program(system: System, names: Iterable[str], step: float | None, loaded: bool) -> Program | None:
    """The program of a system, traced at its first use and compared with torch; None where it has none."""
    base = system.base if isinstance(system, ExtendedSystem) else system
    key = (_names(system), tuple(names), step, loaded)
    with _filling:
        known = _programs.setdefault(base, {})
        if key not in known:
            try:
                program = program_of(system, key[1], step, loaded)
                known[key] = program if _is_right(system, key[1], step, loaded, program) else None
            except (TraceError, RuntimeError, TypeError, ValueError, LookupError):
                # Equations of a user may do anything; torch runs them as they are, and says what is wrong with them.
                known[key] = None
        return known[key]


def _is_right(system: System, names: Iterable[str], h: float | None, loaded: bool, program: Program) -> bool:
    """Whether a program gives what torch gives: a trace does not see what Python decides by other things.

    What is compared depends on the system alone, so that an answer never depends on which log was simulated first.
    """
    rng, joints = np.random.default_rng(0), system.joints
    shape = (len(TIMES), LANES)

    def drawn(*size: int) -> Tensor:
        return torch.from_numpy(rng.standard_normal(size))

    away = {n: 0.3 * system.parameter(n).prior_sd * drawn(LANES).abs() for n in names}
    efforts = []
    for c in system.commands:
        low, high = max(c.low, -BROAD), min(c.high, BROAD)
        efforts.append(low + (high - low) * torch.from_numpy(rng.random((CHECKED, *shape))))
    start = tuple(drawn(*shape) for _ in range(2 * joints))
    slope = tuple(drawn(CHECKED, *shape) for _ in efforts)
    loads = drawn(CHECKED, joints, *shape) if loaded else None
    times = torch.tensor(TIMES, dtype=torch.float64)[:, None]
    broad = StepsInput(SHORT if h is None else h, start, times, efforts, slope, loads)
    if h is None:
        # One step in two pieces, of which the first lane has one.
        first = torch.from_numpy(rng.random((CHECKED // 2, *shape)))
        first[..., 0] = 1.0
        length = SHORT * torch.stack([first, 1.0 - first], 1).flatten(0, 1)
        loads = None if loads is None else loads[: CHECKED // 2]
        broad = broad._replace(length=length, pieces=2, loads=loads)
    # Both ways round differently, and a motion that diverges multiplies that without bound: the sine of an angle of
    # 1e80 rad is a matter of rounding alone.
    share = torch.ones(LANES, dtype=torch.float64)
    for _ in range(WEAKENED):
        given, values = _weaker(broad, share), _values(system, away, share)
        wanted = _in_torch(system, values, given)
        moderate = torch.from_numpy((np.abs(wanted[0]) < FAR).all((0, 1, 2)))
        if moderate.all():
            break
        share = torch.where(moderate, share, share * WEAKER)
    found = _run(system, values, given, program)
    pairs = zip(wanted, found, strict=True)
    return all(np.allclose(b, a, rtol=SAME, atol=SAME, equal_nan=True) for a, b in pairs)


def _weaker(given: StepsInput, share: Tensor) -> StepsInput:
    """Start and drive of each lane times a share (L,)."""
    return given._replace(
        start=tuple(x * share for x in given.start),
        begin=tuple(x * share for x in given.begin),
        slope=tuple(x * share for x in given.slope),
        loads=None if given.loads is None else given.loads * share,
    )


def _values(system: System, away: Mapping[str, Tensor], share: Tensor) -> dict[str, Tensor]:
    """Values (L,) that are a share (L,) of their distance from the nominal ones."""
    listed = [(n, system.parameter(n)) for n in away]
    return {n: (p.value + share * away[n]).clamp(p.low, p.high) for n, p in listed}


def _in_torch(system: System, values: Mapping[str, Tensor], given: StepsInput) -> Rolled:
    """As :func:`_run`, step by step in torch."""
    joints = system.joints
    found = in_torch(equations_of(system, values, None), given)
    shape = given.start[0].shape

    def stacked(parts: Sequence[Tensor]) -> np.ndarray:
        return np.stack([x.expand(-1, *shape).numpy() for x in parts])

    return stacked(found.value), stacked(found.left[joints:]), stacked(found.right[joints:])


def _run(system: System, values: Mapping[str, Tensor], given: StepsInput, program: Program) -> Rolled:
    """States (2 J, n + 1, W, L), and accelerations (J, n, W, L) at both ends of each step."""
    from deepkoco.fit.simulate.bytecode.machine import BLOCK, roll

    shape = tuple(given.start[0].shape)
    columns, total, joints = int(np.prod(shape)), len(given.begin[0]), system.joints
    steps = total // given.pieces

    def flat(tensor: Tensor) -> np.ndarray:
        return np.ascontiguousarray(tensor.expand(shape).numpy()).reshape(columns)

    start = [flat(x) for x in given.start]
    start += [np.zeros(columns) for _ in program.rubbing]
    if program.memories:
        start += [flat(x) for x in first_memory(equations_of(system, values, None), given)]
    parameters = np.empty((len(program.parameters), columns))
    for row, name in enumerate(program.parameters):
        parameters[row] = flat(values[name])
    begin, slope = (
        np.stack([x.expand(total, *shape).numpy().reshape(total, columns) for x in each], 1)
        for each in (given.begin, given.slope)
    )
    loads = np.empty((0, 0, 0))
    if given.loads is not None:
        loads = np.ascontiguousarray(given.loads.expand(steps, joints, *shape).numpy()).reshape(
            steps, joints, columns
        )
    length = np.empty((0, 0))
    if given.length is not None:
        length = np.ascontiguousarray(given.length.expand(total, *shape).numpy()).reshape(total, columns)
    value = np.empty((2 * joints, steps + 1, columns))
    first, last = np.empty((joints, steps, columns)), np.empty((joints, steps, columns))
    p = program
    roll(
        p.prologue, p.step, p.contact, p.again, p.mend, p.remember, np.zeros((p.count, BLOCK)), p.constants, p.fixed,
        parameters, p.known, np.stack(start), p.state_rows, begin, slope, length, given.pieces, p.effort_rows,
        flat(given.time), p.time_rows, p.length_rows, loads, p.load_rows, given.step, p.after_rows, p.near_row,
        np.array(p.rubbing, np.int64), p.level_rows, p.inverse_rows, p.first_rub, p.second_rub, p.creep_rows,
        p.creep_rates, p.impulsive, p.mended_rows, p.memory_rows, value, first, last,
    )  # fmt: skip
    return (
        value.reshape(2 * joints, steps + 1, *shape),
        first.reshape(joints, steps, *shape),
        last.reshape(joints, steps, *shape),
    )
