"""Real logs as cases: the questions of `real_logs`, with what is known of their answers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from deepkoco.fit.data.windows import cut_windows, estimate_channels, moving, window_length
from deepkoco.systems import any_system
from experiments.studies.diagnosis.hidden_cause.kinds import NOTHING
from experiments.studies.diagnosis.hidden_cause.questions import Handed, Question, Truth
from experiments.studies.diagnosis.real_log_studies import STUDIES, FitRequest, Study

DRY = frozenset({"coulomb", "stribeck", "bristle", "lugre", "load_friction"})
LATE = frozenset({"actuation_delay", "sensing_delay", "lag"})
# What a person who knows the unit would say; nobody knows the others.
KNOWN: dict[tuple[str, str], tuple[str, frozenset[str]]] = {
    ("dfki_pendulum", "held-out controllers"): ("dry friction", DRY),
    ("qube_furuta", "held-out episodes"): (
        "delay",
        LATE | {"actuation_delay(all)", "actuation_delay(joint 1)"},
    ),
    **{("qube_furuta", f"control {k}"): (NOTHING, frozenset([NOTHING])) for k in (2, 3, 4, 5)},
    ("go1_pendulum", "told 0 kg, given 1 kg, baseline of 0 kg"): ("payload", frozenset({"payload"})),
}


def real_cases(data: Path) -> Iterator[tuple[str, str]]:
    """(folder, question) of every real case whose folder is there.

    Questions that tell how logs differ are left out: not every entrant can be told.
    """
    for folder, study in STUDIES.items():
        if (data / folder).is_dir():
            for name, asked in study.questions.items():
                if not any(piece.known for piece in (*asked.train, *asked.test, *asked.healthy)):
                    yield folder, name


def real_question(data: Path, folder: str, name: str) -> Question:
    """Read the logs of one question.

    Raises:
        LogError: A file is missing or cannot be used.
    """
    study: Study = STUDIES[folder]
    asked: FitRequest = study.questions[name]
    train, test, healthy = (
        tuple(study.recordings(data / folder, pieces)) for pieces in (asked.train, asked.test, asked.healthy)
    )
    system = any_system(study.system)
    window = asked.window or study.window or window_length(system)
    held = None
    if test:
        held = cut_windows(test, system, window, estimate_channels(test, system))
        held = held.take(moving(held)) if moving(held).any() else held
    kind, right = KNOWN.get((folder, name), ("not known", frozenset()))
    truth = Truth(
        case=f"{folder}/{name}",
        kind=kind,
        inside=True,
        joint="",
        sizes="",
        right=right,
        strength=float("nan"),
        robot=system.name,
        condition=f"{len(healthy)} real healthy logs",
        seconds=sum(log.stop - log.start for log in train),
        held=held if held is not None and len(held) else None,
    )
    return Question(Handed(system, None, train, healthy, window, 0), truth)
