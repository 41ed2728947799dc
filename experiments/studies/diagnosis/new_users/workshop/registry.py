"""The robots of this folder, and the logs of their cases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.workshop import (
    arm,
    balancer,
    beam,
    coil,
    geared,
    hoist,
    linkage,
    roll,
    scara,
    turntable,
)
from experiments.studies.diagnosis.new_users.workshop.bench import Robot

OFF = 0.5  # declared standard deviations by which a unit differs from its description
LEAST = 0.2  # share of its declared value that a parameter keeps
ROBOTS = (
    beam.ROBOT,
    balancer.ROBOT,
    roll.ROBOT,
    geared.ROBOT,
    arm.ROBOT,
    turntable.ROBOT,
    hoist.ROBOT,
    coil.ROBOT,
    scara.ROBOT,
    linkage.ROBOT,
)
ROBOT_OF: dict[str, Robot] = {name: robot for robot in ROBOTS for name in robot.cases}
WORKSHOP: dict[str, Case] = {name: robot.cases[name] for name, robot in ROBOT_OF.items()}


def write_workshop_case(name: str, folder: Path, seed: int = 0) -> Path:
    """Write the log of a case of this folder; see :func:`write_robot_case`."""
    return write_robot_case(ROBOT_OF[name], name, folder, seed)


def write_robot_case(robot: Robot, name: str, folder: Path, seed: int = 0) -> Path:
    """Write the log of a case and its healthy logs into a folder, and return the former.

    Args:
        robot: The robot.
        name: Name of its case.
        folder: Folder, which exists.
        seed: Added to the case's own seed; other units, commands and noise.
    """
    case = robot.cases[name]
    rng = np.random.default_rng(7 * sum(map(ord, name)) + len(name) + 100003 * seed)
    unit = {
        n: max(v + OFF * robot.spread[n] * rng.standard_normal(), LEAST * v) for n, v in robot.nominal.items()
    }
    log = folder / f"log{robot.suffix}"
    robot.write(log, _own(case, unit, case.hidden, rng), rng)
    for k in range(case.healthy):
        robot.write(folder / f"healthy{k + 1}{robot.suffix}", _own(case, unit, {}, rng), rng)
    return log


def _own(case: Case, unit: dict[str, float], hidden: dict[str, float], rng: Any) -> dict[str, float]:
    """Parameters of one log: those of the unit, which vary from log to log, and what is hidden."""
    return {n: v * (1.0 + case.spread * rng.standard_normal()) for n, v in unit.items()} | hidden
