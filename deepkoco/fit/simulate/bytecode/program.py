"""The program of a system: its integration step as bytecode, traced from the same equations as the steps in torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.simulate.bytecode.translate import Nodes, Rows, instructions, needed_for, translated
from deepkoco.fit.simulate.equations import Equations, equations_of
from deepkoco.fit.simulate.step import (
    Contact,
    Drive,
    Step,
    bound_of,
    contact_of,
    directions,
    impelled,
    near_of,
    step_again,
    step_of,
    with_mean_ends,
)
from deepkoco.graph.execution.fused.trace import TraceError, trace
from deepkoco.systems.dry_friction import Levels, Rubbed, StepLength, with_ahead, without_ahead
from deepkoco.systems.motion import Motion
from deepkoco.systems.system import System

ONE = (1, 1)  # shape of an example: one window in one lane


@dataclass(frozen=True)
class Program:
    """Instructions of a step, and the rows in which its values lie; see :func:`machine.roll`.

    Attributes:
        prologue, step, contact, again, mend, remember: (K, 5) instructions.
        count: Rows of the table.
        constants: (c,) numbers.
        fixed: (c,) their rows.
        parameters: Names that are read.
        known: Their rows.
        state_rows: Rows of angles, speeds, shares at rest and memories.
        effort_rows: (3, M)
        time_rows: (3,)
        length_rows: Row of the length of the step; none where all steps have one length.
        load_rows: (J,) or none.
        after_rows, near_row, mended_rows, memory_rows: Rows of results.
        level_rows, inverse_rows, first_rub, second_rub: Rows from which friction loads are found, and theirs.
        creep_rows: Rows of the inertia with which each friction creeps; none where it holds.
        creep_rates: The rates of these.
        impulsive: Whether friction is an impulse of the whole step: it is found once.
        rubbing: Joints with dry friction.
        memories: Number of values that effects remember.
    """

    prologue: np.ndarray
    step: np.ndarray
    contact: np.ndarray
    again: np.ndarray
    mend: np.ndarray
    remember: np.ndarray
    count: int
    constants: np.ndarray
    fixed: np.ndarray
    parameters: tuple[str, ...]
    known: np.ndarray
    state_rows: np.ndarray
    effort_rows: np.ndarray
    time_rows: np.ndarray
    length_rows: np.ndarray
    load_rows: np.ndarray
    after_rows: np.ndarray
    near_row: int
    level_rows: np.ndarray
    inverse_rows: np.ndarray
    first_rub: np.ndarray
    second_rub: np.ndarray
    creep_rows: np.ndarray
    creep_rates: np.ndarray
    impulsive: bool
    mended_rows: np.ndarray
    memory_rows: np.ndarray
    rubbing: tuple[int, ...]
    memories: int


def program_of(system: System, names: Sequence[str], h: float | None, loaded: bool) -> Program:
    """Trace the step of a system and translate it.

    Args:
        system: The system.
        names: Parameters that have values.
        h: Step [s]; None where each simulation has a length of its own for each step.
        loaded: Whether there are outside loads.

    Raises:
        TraceError: The equations do something that is no instruction, or look at values.
    """
    return _Builder(system, names, h, loaded).program()


class _Builder:
    def __init__(self, system: System, names: Sequence[str], h: float | None, loaded: bool) -> None:
        self.system, self.joints = system, system.joints
        self.given_h, self.length = h, ["h"] if h is None else []
        given = {n: system.parameter(n).value for n in names}
        self.parameters = {f"p.{n}": torch.full(ONE, v, dtype=torch.float64) for n, v in given.items()}
        plain = equations_of(
            system, {n: torch.tensor(v, dtype=torch.float64) for n, v in given.items()}, None
        )
        self.rubbing, self.memories = plain.friction.joints, len(plain.memory.parts)
        self.impulsive, creeps = plain.impulsive, plain.friction.creeps
        self.rates = () if creeps is None else tuple(creeps[j].rate for j in self.rubbing)
        self.ahead = bool(self.rubbing) and plain.friction.ahead is not None
        count, joints = len(system.commands), range(system.joints)
        zero = torch.zeros(ONE, dtype=torch.float64)
        self.state = [f"{x}.{j}" for x in ("q", "v") for j in joints]
        self.state += [f"r.{j}" for j in self.rubbing] + [f"m.{k}" for k in range(self.memories)]
        self.efforts = [[f"e{s}.{k}" for k in range(count)] for s in range(3)]
        self.times = ["t0", "t1", "t2"]
        self.loads = [f"f.{j}" for j in joints] if loaded else []
        ends, rubbing = ("q", "v", "first", "last"), self.rubbing
        self.after = [f"after.{x}.{j}" for x in ends for j in joints]
        self.levels = [f"{x}.{j}" for x in ("slide", "stick") for j in rubbing]
        self.inverse = [f"inverse.{j}.{k}" for j in joints for k in joints] if rubbing else []
        self.soft = [f"creep.{j}" for j in rubbing] if self.rates else []
        # Speeds from which friction loads are found: those after a step, or without the armatures of an engine.
        self.early = [[f"early{n}.{j}" for j in joints] if self.ahead else [] for n in (1, 2)]
        self.bare = [f"bare.{j}.{k}" for j in joints for k in joints] if self.ahead else []
        self.applied = [f"applied.{j}" for j in rubbing]
        twice = bool(rubbing) and not self.impulsive
        self.again = [f"again.{x}.{j}" for x in ends for j in joints] if twice else []
        self.shares = [f"share.{j}" for j in rubbing] if twice else []
        # Constant friction loads of the second step.
        self.loaded = [f"loaded.{j}" for j in rubbing] if twice else []
        # What a friction loop writes: speeds, ways, friction loads and holding loads.
        self.found = [
            [f"{x}{n}.{j}" for x in ("speed", "moved") for j in joints]
            + [f"{x}{n}.{j}" for x in ("load", "hold") for j in rubbing]
            for n in (1, 2)
        ]
        moving = [*self.state, *(n for e in self.efforts for n in e), *self.times, *self.loads, *self.length]
        self.moving = {name: zero.clone() for name in moving}

    def program(self) -> Program:
        nodes, pool = Nodes(), Rows()
        rows: dict[int, int] = {}
        inputs = {n: nodes.add(("input", n), steady=True) for n in self.parameters}
        between = [
            *self.after,
            *self.levels,
            *self.inverse,
            *self.soft,
            *self.bare,
            *self.early[0],
            *self.applied,
            *self.again,
            *self.early[1],
            *self.shares,
            *self.loaded,
        ]
        found = [n for own in self.found[: 1 if self.impulsive else 2] for n in own] if self.rubbing else []
        inputs |= {n: nodes.add(("input", n)) for n in (*self.moving, *between, *found)}
        known = {n: torch.zeros(ONE, dtype=torch.float64) for n in inputs if n not in self.parameters}
        rubs = bool(self.rubbing)
        twice = rubs and not self.impulsive
        stages = {
            "step": self._outputs(nodes, self._step, known, inputs),
            "contact": self._outputs(nodes, self._contact, known, inputs) if rubs else {},
            "again": self._outputs(nodes, self._again, known, inputs) if twice else {},
            "mend": self._outputs(nodes, self._mended, known, inputs) if rubs else {},
            "remember": self._outputs(nodes, self._remembered, known, inputs) if self.memories else {},
        }
        done = {k for k, node in enumerate(nodes.listed) if node[0] in ("input", "constant")}
        later = {inputs[n] for n in between}  # what a stage leaves lies in the rows of its results
        rows |= {node: pool.take() for node in sorted(done - later)}
        wanted = [node for stage in stages.values() for node in stage.values()]
        moving = [n for n in needed_for(nodes, wanted, done) if not nodes.steady[n]]
        steady = {s for n in moving for s in nodes.listed[n][1:] if nodes.steady[s] and s not in done}
        prologue = instructions(nodes, sorted(steady), rows, done, pool)
        done |= steady
        code = {}
        for name, stage in stages.items():
            code[name] = instructions(nodes, list(stage.values()), rows, done, pool)
            rows |= {inputs[n]: rows[node] for n, node in stage.items() if n in between}

        constants = [k for k in sorted(done) if nodes.listed[k][0] == "constant"]
        used = [n for n in self.parameters if inputs[n] in rows]
        joints = range(self.joints)

        def places(names: Sequence[str]) -> np.ndarray:
            return np.array([rows[inputs[n]] for n in names], dtype=np.int64)

        def results(stage: str, names: Sequence[str]) -> np.ndarray:
            return np.array([rows[stages[stage][n]] for n in names], dtype=np.int64)

        ends = [n.replace("after.", "end.") for n in self.after]
        after, again = (
            own or [f"{x}.v.{j}" for j in joints]
            for own, x in zip(self.early, ("after", "again"), strict=True)
        )
        slide = self.levels[: len(self.rubbing)]
        levels = [*slide, *slide] if self.impulsive else self.levels  # an impulse has one level
        return Program(
            prologue,
            code["step"],
            code["contact"],
            code["again"],
            code["mend"],
            code["remember"],
            pool.count,
            np.array([nodes.listed[k][2] for k in constants], dtype=np.float64),
            np.array([rows[k] for k in constants], dtype=np.int64),
            tuple(n.removeprefix("p.") for n in used),
            places(used),
            places(self.state),
            np.array([places(e) for e in self.efforts], dtype=np.int64).reshape(3, -1),
            places(self.times),
            places(self.length),
            places(self.loads),
            places(self.after),
            rows[stages["step"]["near"]] if rubs else -1,
            places(levels),
            places(self.bare or self.inverse),
            places([*after, *self.applied, *self.found[0]] if rubs else []),
            places([*again, *self.loaded, *self.found[1]] if twice else []),
            places(self.soft),
            np.array(self.rates, dtype=np.float64),
            self.impulsive,
            results("mend", [*ends, *(f"rest.{j}" for j in self.rubbing)]) if rubs else places([]),
            results("remember", [f"m.{k}" for k in range(self.memories)]),
            self.rubbing,
            self.memories,
        )

    def _outputs(
        self,
        nodes: Nodes,
        function: Callable[[dict[str, Tensor]], dict[str, Tensor]],
        moving: Mapping[str, Tensor],
        inputs: Mapping[str, int],
    ) -> dict[str, int]:
        """Nodes of the results of a function, each in a row of its own."""
        traced = trace(function, {**self.parameters, **moving})
        found = translated(nodes, traced, inputs)
        return {name: nodes.copy(node) for name, node in found.items()}

    def _given(self, x: Mapping[str, Tensor]) -> tuple[Equations, tuple, tuple, Drive, tuple]:
        """Equations, angles, speeds, drive and directions of dry friction."""
        joints = range(self.joints)
        values = {n: x[f"p.{n}"] for n in (name.removeprefix("p.") for name in self.parameters)}
        equations = equations_of(self.system, values, None)
        angle, speed = (tuple(x[f"{s}.{j}"] for j in joints) for s in ("q", "v"))
        rest = tuple(x[f"r.{j}"] if j in self.rubbing else None for j in joints)
        efforts = [tuple(x[n] for n in names) for names in self.efforts]
        if self.impulsive:  # a step of an engine has the mean effort
            efforts = [efforts[1]] * 3
        t0, t1, t2 = (x[n] for n in self.times)
        loads = tuple(x[n] for n in self.loads) if self.loads else None
        memory = tuple(x[f"m.{k}"] for k in range(self.memories))
        drive = Drive((efforts[0], efforts[1], efforts[2]), (t0, t1, t2), loads, memory)
        return equations, angle, speed, drive, directions(speed, rest, equations.friction)

    def _h(self, x: Mapping[str, Tensor]) -> StepLength:
        return x["h"] if self.given_h is None else self.given_h

    def _step(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        equations, angle, speed, drive, direction = self._given(x)
        step = step_of(equations, angle, speed, drive, direction, self._h(x))
        found = self._named(step, self.after)
        near = near_of(equations, angle, speed, drive, step)
        return found if near is None else {**found, "near": near}

    def _contact(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        equations, angle, speed, drive, direction = self._given(x)
        at = contact_of(equations, angle, speed, drive, direction)
        found = {f"slide.{j}": at.slide[j] for j in self.rubbing} | {
            f"stick.{j}": at.stick[j] for j in self.rubbing
        }
        found |= {f"applied.{j}": at.applied[j] for j in self.rubbing}
        found |= _as_table("inverse", at.inverse)
        if (creeps := equations.friction.creeps) is not None:
            found |= {f"creep.{j}": creeps[j].inertia.expand(ONE) for j in self.rubbing}
        if (ahead := equations.friction.ahead) is not None and self.ahead:
            after = tuple(x[f"after.v.{j}"] for j in range(self.joints))
            bare, early = without_ahead(speed, after, at.inverse, self._h(x), ahead)
            found |= _as_table("bare", bare) | {f"early1.{j}": v for j, v in enumerate(early)}
        return {n: v for n, v in found.items() if v is not None}

    def _again(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        equations, angle, speed, drive, direction = self._given(x)
        at = Contact((), self._of_rubbing(x, "slide"), self._of_rubbing(x, "stick"), ())
        load = self._of_rubbing(x, "load1")
        again, shares, applied = step_again(equations, angle, speed, drive, direction, at, load, self._h(x))
        found = self._named(again, self.again)
        found |= {f"share.{j}": v for j, v in enumerate(shares) if v is not None}
        if (ahead := equations.friction.ahead) is not None and self.ahead:
            _, early = without_ahead(speed, again.speed, self._inverse(x), self._h(x), ahead)
            found |= {f"early2.{j}": v for j, v in enumerate(early)}
        return found | {f"loaded.{j}": v for j, v in enumerate(applied) if v is not None}

    def _mended(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        joints, last = range(self.joints), 1 if self.impulsive else 2
        equations, angle, speed, _, direction = self._given(x)
        speeds, ways = (tuple(x[f"{s}{last}.{j}"] for j in joints) for s in ("speed", "moved"))
        found = Rubbed(speeds, ways, self._of_rubbing(x, f"load{last}"), self._of_rubbing(x, f"hold{last}"))
        slide, stick = self._of_rubbing(x, "slide"), self._of_rubbing(x, "stick")
        if self.impulsive:
            step = impelled(angle, speed, found, stick, direction, self._h(x))
        else:
            parts = [tuple(x[f"again.{s}.{j}"] for j in joints) for s in ("q", "v", "first", "last")]
            again = Step(parts[0], parts[1], parts[2], parts[3], (None,) * self.joints)
            if self.ahead:
                loaded = self._of_rubbing(x, "loaded")
                found = with_ahead(speed, again.speed, loaded, found, self._inverse(x), self._h(x))
            step = bound_of(angle, speed, again, self._of_rubbing(x, "share"), stick, found, self._h(x))
            if self.rates:
                step = with_mean_ends(equations.friction, slide, speed, step, self._h(x))
        held = {f"rest.{j}": step.rest[j] for j in self.rubbing}
        ends = [n.replace("after.", "end.") for n in self.after]
        return {**self._named(step, ends), **{n: v for n, v in held.items() if v is not None}}

    def _inverse(self, x: Mapping[str, Tensor]) -> tuple[tuple[Tensor, ...], ...]:
        joints = range(self.joints)
        return tuple(tuple(x[f"inverse.{j}.{k}"] for k in joints) for j in joints)

    def _of_rubbing(self, x: Mapping[str, Tensor], name: str) -> Levels:
        return tuple(x[f"{name}.{j}"] if j in self.rubbing else None for j in range(self.joints))

    def _remembered(self, x: dict[str, Tensor]) -> dict[str, Tensor]:
        equations, angle, _, drive, _ = self._given(x)
        after = [tuple(x[f"after.{s}.{j}"] for j in range(self.joints)) for s in ("q", "v")]
        now = Motion(after[0], after[1], drive.efforts[2], None, drive.times[2], equations.smoothing)
        return {f"m.{k}": v for k, v in enumerate(equations.memory.advanced(drive.memory, angle, now))}

    def _named(self, step: Step, names: Sequence[str]) -> dict[str, Tensor]:
        parts = (step.angle, step.speed, step.first, step.last)
        return dict(zip(names, (v for part in parts for v in part), strict=True))


def _as_table(name: str, rows: Sequence[Sequence[Tensor]]) -> dict[str, Tensor]:
    return {f"{name}.{j}.{k}": value for j, row in enumerate(rows) for k, value in enumerate(row)}


__all__ = ["Program", "TraceError", "program_of"]
