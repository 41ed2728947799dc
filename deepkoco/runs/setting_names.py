"""Proposals for mistyped settings of a Hydra command, whose own words run over six lines and name no other setting."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from deepkoco.runs.agents import AGENTS, settings_class
from deepkoco.runs.settings import EvaluateConfig, ExperimentError, TrainRunConfig
from deepkoco.suggestion import did_you_mean

DEFAULT_AGENT = "deepkoco"


def check_names(command: str, arguments: Sequence[str]) -> None:
    """Refuse a setting that there is not, where another one is near.

    Args:
        command: File in configs/, without its ending.
        arguments: Of the command, without its name.

    Raises:
        ExperimentError: Proposes the nearest setting. What is like no other is left for Hydra to refuse.
    """
    known = _known_settings(command, arguments)
    for argument in arguments:
        name = argument.partition("=")[0]
        # Added (+) and removed (~) settings, options and files of groups are Hydra's to judge.
        if not re.fullmatch(r"\w+(\.\w+)*", name) or name.split(".")[0] == "hydra" or name in known:
            continue
        # Arguments of an environment have the names that the file of the task gives them.
        if any(known.get(group) for group in _groups(name)):
            continue
        if suggestion := did_you_mean(name, known):
            raise ExperimentError(f"{name}: there is no such setting{suggestion}")


def _known_settings(command: str, arguments: Sequence[str]) -> dict[str, bool]:
    """Dotted names, and whether a setting holds entries of any name."""
    if command == "evaluate":
        return dict(_names(asdict(EvaluateConfig())))
    chosen = [a.removeprefix("agent=").split(",") for a in arguments if a.startswith("agent=")]
    agents = [name for name in (chosen[-1] if chosen else [DEFAULT_AGENT]) if name in AGENTS]
    known: dict[str, bool] = {}
    for name in agents:
        known |= dict(_names(asdict(TrainRunConfig(agent=settings_class(name)()))))
    return known


def _names(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, bool]]:
    """Dotted names of settings and of the groups that they are in; a group without a setting takes any."""
    for name, value in settings.items():
        yield prefix + name, isinstance(value, Mapping) and not value
        if isinstance(value, Mapping):
            yield from _names(value, f"{prefix}{name}.")


def _groups(name: str) -> Iterator[str]:
    """Groups that a dotted name is in."""
    parts = name.split(".")
    return (".".join(parts[:k]) for k in range(1, len(parts)))
