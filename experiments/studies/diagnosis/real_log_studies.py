"""What is studied on each real log: system, columns, which stretches are fitted and which only tested."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.diagnose.causes import catalogue, causes_named
from deepkoco.fit.data.per_log_differences import KEY
from deepkoco.logs.recording import LogError, Recording, read_log
from deepkoco.systems import System, any_system

HELD_OUT = 4  # of further logs, one in four is only tested
ENDLESS = 1e9  # [s]


@dataclass(frozen=True)
class Piece:
    """A stretch of one log.

    Attributes:
        file: Name in the folder.
        start: From [s].
        stop: To [s].
        known: What is known to differ in this log: parameter -> amount.
    """

    file: str
    start: float = 0.0
    stop: float = ENDLESS
    known: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FitRequest:
    """One diagnosis: what is explained, from what baseline, and where it is tested.

    Attributes:
        train: Stretches to be explained.
        test: Stretches that are never fitted; empty: windows of the training logs are kept back.
        healthy: Stretches in which nothing is wrong.
        window: Length of a window [s]; None takes the study's.
        only: Causes to try; empty for the whole catalogue.
        exclude: Causes not to try: names, or kinds for all joints.
    """

    train: tuple[Piece, ...]
    test: tuple[Piece, ...] = ()
    healthy: tuple[Piece, ...] = ()
    window: float | None = None
    only: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()

    def causes(self, system: System) -> tuple[str, ...] | None:
        """Names of the causes to try; None for the whole catalogue."""
        if not self.only and not self.exclude:
            return None
        known = catalogue(system)
        picked = causes_named(known, self.only, system.name) if self.only else tuple(known.values())
        left_out = {c.name for c in causes_named(known, self.exclude, system.name)} if self.exclude else set()
        return tuple(c.name for c in picked if c.name not in left_out)


@dataclass(frozen=True)
class Study:
    """How logs of one kind are read, and the questions that are put to those of the published folder.

    Attributes:
        system: The system that was logged, or its name.
        columns: Channel of the system -> column of the file, and its unit.
        window: Length of a window [s]; None takes about one period of the system.
        questions: By name; the first one is the study's main question.
        measured: Commands whose column is a measurement, not a command: a motor current, which has spikes.
        time: Column of the time stamps [s].
        sidecar: Sidecar of every log; None makes it from ``columns``.
    """

    system: str | System
    columns: Mapping[str, tuple[str, str]]
    window: float | None
    questions: Mapping[str, FitRequest]
    measured: frozenset[str] = frozenset()
    time: str = "t"
    sidecar: Mapping[str, Any] | None = None

    @property
    def mapping(self) -> dict:
        """The sidecar of every log of this kind."""
        if self.sidecar is not None:
            return dict(self.sidecar)
        system = any_system(self.system)
        kinds = {c.name: c.kind for c in (*system.commands, *system.measurements)}
        return {
            "system": self.system,
            "time": {"column": self.time, "unit": "s"},
            "channels": {
                name: {"column": column, "unit": unit, "kind": kinds[name], "checked": name in self.measured}
                for name, (column, unit) in self.columns.items()
            },
        }

    def read(self, folder: Path, piece: Piece) -> Recording:
        """One stretch of a log.

        Raises:
            LogError: The file is missing or cannot be used.
        """
        system = any_system(self.system)
        channels = [(c.name, c.unit, c.kind) for c in (*system.commands, *system.measurements)]
        log = read_log(
            folder / piece.file, self.mapping, system.name, channels=channels, allow_constant_command=True
        ).between(piece.start, piece.stop)
        shifted = {}
        for name in self.measured:
            # A measured torque is a sample in the middle of the time that it stands for, not a command that
            # begins to hold at its stamp.
            series = log.channels[name]
            shifted[name] = replace(series, t=series.t - 0.5 * np.median(np.diff(series.t)))
        meta = {**log.meta, KEY: dict(piece.known)} if piece.known else log.meta
        return replace(log, channels={**log.channels, **shifted}, meta=meta)

    def recordings(self, folder: Path, pieces: Sequence[Piece]) -> list[Recording]:
        """Several stretches."""
        return [self.read(folder, piece) for piece in pieces]


DFKI_PENDULUM = Study(
    "torque_pendulum",
    # The torque from the motor current is the input: the commanded one passes a controller.
    {"torque": ("tau_meas", "N m"), "theta": ("pos", "rad"), "omega": ("vel", "rad/s")},
    window=1.0,
    questions={
        # Later on people push the pendulum.
        "held-out controllers": FitRequest(
            train=(Piece("energy_shaping.csv", 0.0, 4.5), Piece("sac.csv", 0.1, 4.1)),
            test=(Piece("ddp_pd.csv", 0.0, 6.0), Piece("direct_collocation_pd.csv", 0.0, 3.5)),
        )
    },
    measured=frozenset({"torque"}),
)
DOUBLE_PENDULUM = Study(
    "double_pendulum",
    {
        **{f"torque_{j}": (f"tau_meas{j}", "N m") for j in (1, 2)},
        **{f"angle_{j}": (f"pos_meas{j}", "rad") for j in (1, 2)},
        **{f"speed_{j}": (f"vel_meas{j}", "rad/s") for j in (1, 2)},
    },
    window=1.0,
    questions={
        "held-out sinusoids": FitRequest(
            train=tuple(Piece(f"traj_{k:02d}.csv") for k in (0, 2, 3, 5)),
            test=tuple(Piece(f"traj_{k:02d}.csv") for k in (1, 4)),
        ),
        # Torques of a swing-up, three times as large as those that were fitted.
        "held-out closed loop": FitRequest(
            train=tuple(Piece(f"traj_{k:02d}.csv") for k in (0, 2, 3, 5)),
            test=tuple(Piece(f"traj_{k:02d}.csv") for k in (11, 12, 13)),
        ),
    },
    measured=frozenset({"torque_1", "torque_2"}),
)
QUBE_FURUTA = Study(
    "furuta_pendulum",
    {
        "voltage": ("plant_input", "V"),
        "arm_angle": ("theta", "rad"),
        "pendulum_angle": ("alpha", "rad"),
    },
    window=0.3,  # the plant is unstable: an error doubles in about 70 ms
    questions={
        # It is excited from 4 s to 16 s.
        "held-out episodes": FitRequest(
            train=tuple(Piece(f"ep_{k:02d}.csv", 4.0, 10.0) for k in (0, 1, 2, 3)),
            test=tuple(Piece(f"ep_{k:02d}.csv", 4.0, 16.0) for k in (4, 5)),
        ),
        "control": FitRequest(
            train=(Piece("ep_04.csv", 4.0, 10.0),),
            test=(Piece("ep_05.csv", 4.0, 10.0),),
            healthy=tuple(Piece(f"ep_{k:02d}.csv", 4.0, 10.0) for k in (0, 1)),
        ),
    },
)


def _go1(kilograms: int, *names: str, told: bool = True) -> tuple[Piece, ...]:
    """Logs with that mass at the tip; ``told``: the diagnosis knows of it."""
    known = {"payload.mass": float(kilograms)} if told and kilograms else {}
    return tuple(Piece(f"{kilograms}kg_{name}.csv", known=known) for name in names)


_FITTED, _TESTED = ("sin_time_square", "lift_and_drop"), ("sin_sin", "up_and_down")
_SHORT = 1.4  # [s]
_GO1_BASELINE = (*_go1(0, *_FITTED), *_go1(1, *_FITTED))
GO1_PENDULUM = Study(
    "servo_pendulum",
    # The goal is replayed through the servo's law; the logged speed mixes rotor and output and is left out.
    {"goal": ("goal_position", "rad"), "enable": ("torque_enable", "1"), "theta": ("position", "rad")},
    window=2.9,  # two to a log
    questions={
        "what the textbook lacks": FitRequest(_GO1_BASELINE, (*_go1(0, *_TESTED), *_go1(1, *_TESTED))),
        # Two logs of two windows are too few; these questions cut them into four each.
        "control 0 kg": FitRequest(_go1(0, *_TESTED), healthy=_GO1_BASELINE, window=_SHORT),
        "control 1 kg": FitRequest(_go1(1, *_TESTED), healthy=_GO1_BASELINE, window=_SHORT),
        "told 0 kg, given 1 kg": FitRequest(
            _go1(1, *_TESTED, told=False), healthy=_GO1_BASELINE, window=_SHORT
        ),
        "told 0 kg, given 1 kg, baseline of 0 kg": FitRequest(
            _go1(1, *_TESTED, told=False), healthy=_go1(0, *_FITTED), window=_SHORT
        ),
    },
)
STUDIES = {
    "go1_pendulum": GO1_PENDULUM,
    "dfki_pendulum": DFKI_PENDULUM,
    "dfki_double_pendulum_A": DOUBLE_PENDULUM,
    "qube_furuta": QUBE_FURUTA,
}
# Real logs without what a diagnosis of motion needs.
ELSEWHERE = {
    "rex_real_delays": "holds delays and no motion; python -m experiments.studies.graph.real_delays studies them",
}


def study_of(folder: Path) -> tuple[Study, dict[str, FitRequest]]:
    """The study of a folder: the published one by its name, else one of the same columns.

    Raises:
        LogError: The folder is missing, is studied elsewhere, or its columns are those of no known kind.
    """
    if folder.name in ELSEWHERE:
        raise LogError(f"{folder}: {ELSEWHERE[folder.name]}")
    if folder.name in STUDIES:
        return STUDIES[folder.name], dict(STUDIES[folder.name].questions)
    if not folder.is_dir():
        raise LogError(f"{folder}: no such folder; known ones are {', '.join(STUDIES)}")
    files = sorted(folder.glob("*.csv"))
    if not files:
        raise LogError(f"{folder}: holds no CSV file")
    with files[0].open(newline="") as file:
        header = set(next(csv.reader(file), []))
    for study in STUDIES.values():
        if {study.time, *(column for column, _ in study.columns.values())} <= header:
            return study, {"held-out logs": split([Piece(f.name) for f in files])}
    wanted = "; ".join(
        f"{n}: {', '.join([s.time, *(c for c, _ in s.columns.values())])}" for n, s in STUDIES.items()
    )
    raise LogError(f"{files[0]}: its columns are those of no known kind of log ({wanted})")


def split(pieces: Sequence[Piece]) -> FitRequest:
    """One log in four is kept for tests, the last one where there are fewer; a single one is cut by windows."""
    if len(pieces) < 2:
        return FitRequest(tuple(pieces))
    every = min(HELD_OUT, len(pieces))
    test = tuple(p for k, p in enumerate(pieces) if k % every == every - 1)
    return FitRequest(tuple(p for p in pieces if p not in test), test)


def parse_piece(text: str) -> Piece:
    """FILE or FILE:FROM:TO as a piece.

    Raises:
        ValueError: The text is neither.
    """
    name, *times = text.rsplit(":", 2)
    if not times:
        return Piece(name)
    if len(times) != 2 or not name:
        raise ValueError(f"{text}: give FILE or FILE:FROM:TO")
    start, stop = (float(x) for x in times)
    if not start < stop:
        raise ValueError(f"{text}: ends before it begins")
    return Piece(name, start, stop)
