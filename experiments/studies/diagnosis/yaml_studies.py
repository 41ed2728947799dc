"""A study of one's own logs as a YAML file: system, sidecar, and which logs are explained, healthy or only tested.

system: arm.xml                  # name, my_robot.py:Class, MJCF or URDF; paths start at this file
sidecar:                         # of every log, as beside a log
  time: {column: t, unit: s}
  channels: {...}
window: 1.5                      # [s]; about one period of the system without it
questions:
  held-out motions:
    train: [a.csv, b.csv:0:4.5]  # FILE or FILE:FROM:TO in seconds, in the folder of the logs
    test: [c.csv]
    healthy: []
    only: [coulomb, viscous]     # causes to try
    exclude: [event]             # causes not to try
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deepkoco.systems import load_system
from deepkoco.yaml_file import YamlFileError, read_yaml
from experiments.studies.diagnosis.real_log_studies import FitRequest, Study, parse_piece

KEYS = ("system", "sidecar", "window", "questions")
QUESTION_KEYS = ("train", "test", "healthy", "window", "only", "exclude")


class StudyFileError(ValueError):
    """A study file cannot be used."""


def read_study(path: Path, logs: Path | None = None) -> Study:
    """Read a study.

    Args:
        path: The YAML file.
        logs: Folder of the logs, in which the system may be a file too.

    Raises:
        StudyFileError: A key is missing or unknown, or a value is of another kind.
    """
    try:
        content = read_yaml(path)
    except YamlFileError as error:
        raise StudyFileError(str(error)) from error
    content = _mapping(content, str(path), KEYS, ("system", "sidecar", "questions"))
    system = load_system(content["system"], (path.parent, *([logs] if logs else []), Path()))
    asked = content["questions"]
    if not isinstance(asked, Mapping) or not asked:
        raise StudyFileError(f"{path}: questions: give a name and its train logs for each question")
    questions = {str(name): _question(f"{path}: {name}", own) for name, own in asked.items()}
    return Study(system, {}, content.get("window"), questions, sidecar=content["sidecar"])


def _question(where: str, content: Any) -> FitRequest:
    own = _mapping(content, where, QUESTION_KEYS, ("train",))
    try:
        train, test, healthy = (
            tuple(parse_piece(str(text)) for text in own.get(key, ())) for key in ("train", "test", "healthy")
        )
    except (TypeError, ValueError) as error:
        raise StudyFileError(f"{where}: {error}") from error
    if not train:
        raise StudyFileError(f"{where}: train: give at least one log")
    return FitRequest(
        train, test, healthy, own.get("window"), tuple(own.get("only", ())), tuple(own.get("exclude", ()))
    )


def _mapping(content: Any, where: str, known: tuple[str, ...], needed: tuple[str, ...]) -> Mapping[str, Any]:
    if not isinstance(content, Mapping):
        raise StudyFileError(f"{where}: gives no keys; known ones are {', '.join(known)}")
    for key in content:
        if key not in known:
            raise StudyFileError(f'{where}: unknown key "{key}"; known ones are {", ".join(known)}')
    for key in needed:
        if key not in content:
            raise StudyFileError(f"{where}: {key} is missing")
    return content
