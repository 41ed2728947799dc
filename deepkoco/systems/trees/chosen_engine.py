"""Which engine a tree is simulated in, by name, and the note of its system that says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from deepkoco.systems.engine_names import MUJOCO, SEMI_IMPLICIT
from deepkoco.systems.trees.tree import Engine

NO_MACHINE = "not as a machine"
USUAL_STEP = 1.0 / 240.0  # of Bullet, for a tree that MuJoCo has no steps for [s]


def engines_with(of_file: Engine | None) -> tuple[str, ...]:
    """Names of the engines that may simulate a tree, that of its file first."""
    return (SEMI_IMPLICIT,) if of_file is None else (MUJOCO, SEMI_IMPLICIT)


def engine_named(of_file: Engine | None, name: str | None, step: float | None) -> Engine | None:
    """The engine of a name; None for a machine, and where a tree has none of this name.

    Semi-implicit steps are taken as they are (:attr:`.System.own_step`), so nothing in them is early or late.

    Args:
        of_file: Engine of the tree's file; None where it states none.
        name: Of :mod:`deepkoco.systems.engine_names`; None for a machine.
        step: Of the engine [s]; None: that of ``of_file``, and without one, 1 / 240.
    """
    engine = of_file if name == MUJOCO else None
    if name == SEMI_IMPLICIT:
        usual = USUAL_STEP if of_file is None else of_file.step
        engine = Engine(None, usual, name=SEMI_IMPLICIT)
    return engine if engine is None or step is None else replace(engine, step=step)


def noted(notes: Sequence[str], engine: Engine | None) -> tuple[str, ...]:
    """Notes of a system with one that says how it is simulated; without that one for a machine."""
    others = tuple(n for n in notes if NO_MACHINE not in n)
    if engine is None:
        return others
    does = ["dry friction creeps"] if engine.softness is not None else []
    does += ["commands act half a step early"] if engine.lead > 0.0 else []
    does += ["dry friction is an impulse of each step"] if engine.name == SEMI_IMPLICIT else []
    long = f"in steps of {1e3 * engine.step:.3g} ms" if engine.step > 0.0 else "in steps too short to show"
    who = "MuJoCo does it" if engine.name == MUJOCO else "engines of rigid bodies do it (Bullet)"
    said = f"simulated as {who}, {NO_MACHINE}: {long} {' and '.join(does) or 'it moves as a machine'}"
    return (*others, said)
