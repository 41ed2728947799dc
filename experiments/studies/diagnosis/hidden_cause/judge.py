"""One row of the benchmark: a case, an entrant, whether its answer is right, what its simulation is worth."""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from deepkoco.fit.threads import one_thread
from experiments.studies.diagnosis.hidden_cause.entrants.as_given import as_given
from experiments.studies.diagnosis.hidden_cause.held_out import held_out_error
from experiments.studies.diagnosis.hidden_cause.kinds import NOTHING, UNKNOWN
from experiments.studies.diagnosis.hidden_cause.questions import Answer, Entrant, Question

COLUMNS = (
    "case", "kind", "inside", "robot", "joint", "sizes", "strength", "condition", "seconds", "entrant", "name",
    "members", "right", "error", "error_given", "cpu_s", "note", "commit",
)  # fmt: skip
FAILED = "failed"


class OutOfTimeError(BaseException):
    """An entrant used more processor time than it may; no entrant should catch it."""


def run(question: Question, entrant: Entrant, limit: float, commit: str = "") -> dict[str, str]:
    """Put a case to an entrant; return its row, plain text only.

    Args:
        question: The case.
        entrant: The method.
        limit: Processor seconds after which it is stopped.
        commit: Kept in the row.
    """
    began = time.process_time()
    answer, note = None, ""
    try:
        with one_thread(), _at_most(limit):
            answer = entrant.answer(question.handed)
        note = answer.note
    except OutOfTimeError:
        note = f"stopped after {limit:g} s"
    except Exception as error:  # one broken answer must not end a benchmark
        note = f"{type(error).__name__}: {str(error)[:200]}"
    spent = time.process_time() - began
    given = _error(as_given(question.handed.system), question)
    error = math.nan
    if answer is not None:
        try:
            with one_thread(), _at_most(limit):
                error = _error(answer.simulate, question)
        except OutOfTimeError:
            note += f"; its simulation was stopped after {limit:g} s"
        except Exception as broken:
            note += f"; its simulation: {type(broken).__name__}: {str(broken)[:200]}"
    truth = question.truth
    row = {
        "case": truth.case,
        "kind": truth.kind,
        "inside": int(truth.inside),
        "robot": truth.robot,
        "joint": truth.joint,
        "sizes": truth.sizes,
        "strength": f"{truth.strength:.4g}",
        "condition": truth.condition,
        "seconds": f"{truth.seconds:.1f}",
        "entrant": entrant.name,
        "name": FAILED if answer is None else answer.name,
        "members": json.dumps([] if answer is None else list(answer.members)),
        "right": int(answer is not None and is_right(answer, truth.right)) if truth.right else "",
        "error": f"{error:.6g}",
        "error_given": f"{given:.6g}",
        "cpu_s": f"{spent:.2f}",
        "note": note.replace("\n", " "),
        "commit": commit,
    }
    return {c: str(row[c]) for c in COLUMNS}


def is_right(answer: Answer, right: frozenset[str]) -> bool:
    """Whether the first answer, or one that the entrant cannot tell from it, is right.

    "nothing" and "unknown" stand alone: a class cannot hedge with them.
    """
    if answer.name in (NOTHING, UNKNOWN):
        return answer.name in right
    return bool(({answer.name, *answer.members} - {NOTHING, UNKNOWN}) & right)


def _error(simulate: Any, question: Question) -> float:
    held = question.truth.held
    return math.nan if held is None else held_out_error(simulate, held, question.handed.system.joints)


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    def stop(*_: Any) -> None:
        raise OutOfTimeError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
