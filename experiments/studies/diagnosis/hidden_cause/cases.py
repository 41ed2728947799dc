"""Generated cases: each follows from the seed and its number alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepkoco.fit.data.windows import cut_windows, estimate_channels, moving, window_length
from deepkoco.systems import any_system
from experiments.studies.diagnosis.hidden_cause.kinds import (
    KINDS,
    NOTHING,
    Hidden,
    drawn_share,
    joints_for,
    place_of,
    right_names,
    round_of_kinds,
    size_text,
)
from experiments.studies.diagnosis.hidden_cause.questions import Handed, Question, Truth
from experiments.studies.diagnosis.hidden_cause.unit import Taken, Unit
from tests.oracle.mujoco_robots import Robot, cart_pole, pendulum, random_arm

CONDITIONS = {"no healthy log": 0.35, "one": 0.3, "three": 0.2, "one, itself bad": 0.15}
ROBOTS = {"pendulum": 0.3, "servo_pendulum": 0.3, "cart_pole": 0.2, "arm2_motor": 0.2}
LOG, HEALTHY, HELD_OUT = (15.0, 40.0), (15.0, 25.0), 12.0  # lengths [s]
SPREAD = (0.01, 0.02)  # standard deviation of masses and friction from day to day, as a share
WRONG_IN_HEALTHY = ("coulomb", "spring", "damping")  # what a healthy log hides that is itself bad


@dataclass(frozen=True)
class Case:
    """One generated case.

    Attributes:
        seed: Of the benchmark.
        index: Number of the case.
        robot: The model as given.
        hidden: What is hidden; None for a healthy unit.
        condition: One of `CONDITIONS`.
        bad: What a healthy log that is itself bad hides; None otherwise.
        seconds: Length of the log to explain [s].
        spread: From day to day.
    """

    seed: int
    index: int
    robot: Robot
    hidden: Hidden | None
    condition: str
    bad: Hidden | None
    seconds: float
    spread: float

    @property
    def name(self) -> str:
        """Name of the case."""
        return f"{self.seed}/{self.index}"

    def question(self, folder: Path) -> Question:
        """Record the logs; the model as given is written below a folder."""
        own = int(np.random.SeedSequence([self.seed, self.index, 51]).generate_state(1)[0])
        unit = Unit(self.robot, self.hidden, own)
        # How the speed is made is no fault of the day, so healthy logs have it too.
        well = Unit(self.robot, self.bad, own, unit.differentiated)
        days = [int(x) for x in np.random.SeedSequence([self.seed, self.index, 52]).generate_state(6)]
        spread = 0.0 if self.condition == "no healthy log" else self.spread
        taken = Taken(days[0], self.seconds, spread)
        raw = unit.record(taken)
        lengths = np.random.default_rng([self.seed, self.index, 53]).uniform(*HEALTHY, 3)
        count = {"no healthy log": 0, "three": 3}.get(self.condition, 1)
        healthy = [well.recording(Taken(days[2 + k], float(lengths[k]), spread)) for k in range(count)]
        held_out = unit.recording(Taken(days[1], HELD_OUT, spread, held_out=True))
        drawn = int(np.random.SeedSequence([self.seed, self.index, 54]).generate_state(1)[0])
        path = folder / f"{drawn:08x}" / "robot.xml"  # entrants see the path; it says nothing of the case
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self.robot.xml)
        system = any_system(str(path))
        log, window = unit.recording(taken), window_length(system)
        held = cut_windows([held_out], system, window, estimate_channels([held_out], system))
        moves = moving(held)
        held = held.take(moves) if moves.any() else held
        kind = NOTHING if self.hidden is None else self.hidden.kind
        truth = Truth(
            case=self.name,
            kind=kind,
            inside=kind == NOTHING or KINDS[kind].inside,
            joint="" if self.hidden is None else self.hidden.joint,
            sizes=size_text(self.hidden),
            right=right_names(self.hidden, self.robot, system),
            strength=unit.strength(raw, taken),
            robot=self.robot.name,
            condition=self.condition,
            seconds=self.seconds,
            held=held,
        )
        return Question(Handed(system, self.robot.xml, (log,), tuple(healthy), window, drawn), truth)


def draw_case(seed: int, index: int, longest: float = LOG[1]) -> Case:
    """Draw a case.

    Args:
        seed: Of the benchmark.
        index: Number of the case.
        longest: Longest log to explain [s].
    """
    size = len(KINDS) + round_of_kinds(0, 0).count(NOTHING)
    kind = round_of_kinds(seed, index // size)[index % size]
    rng = np.random.default_rng([seed, index, 50])
    robot = _robot_for(kind, rng)
    seconds = float(rng.uniform(LOG[0], max(longest, LOG[0])))
    joint = str(rng.choice(joints_for(robot, kind)))
    hidden = None if kind == NOTHING else _hidden(kind, robot, joint, seconds, rng)
    condition = str(rng.choice(list(CONDITIONS), p=list(CONDITIONS.values())))
    bad = None
    if condition == "one, itself bad":
        wrong = str(rng.choice([k for k in WRONG_IN_HEALTHY if k != kind]))
        bad = _hidden(wrong, robot, str(rng.choice(joints_for(robot, wrong))), seconds, rng)
    return Case(seed, index, robot, hidden, condition, bad, seconds, float(rng.uniform(*SPREAD)))


def _hidden(kind: str, robot: Robot, joint: str, seconds: float, rng: np.random.Generator) -> Hidden:
    sizes = KINDS[kind].draw(drawn_share(rng), place_of(robot, joint, seconds), rng)
    return Hidden(kind, joint, sizes)


def _robot_for(kind: str, rng: np.random.Generator) -> Robot:
    """Draw a robot that can have the cause."""
    while True:
        name = str(rng.choice(list(ROBOTS), p=list(ROBOTS.values())))
        if name == "cart_pole":
            robot = cart_pole(rng)
        elif name == "arm2_motor":
            robot = random_arm(rng, 2, "motor")
        else:
            robot = pendulum(rng, "motor" if name == "pendulum" else "position")
        if joints_for(robot, kind):
            return robot
