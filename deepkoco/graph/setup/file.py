"""Files that hold a setup, and what a setup may hold."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import yaml

from deepkoco.graph.model.graph import Graph
from deepkoco.graph.setup.describe import OF_A_CONNECTION, OF_A_NODE, describe_setup
from deepkoco.output.whole_file import write_whole_text
from deepkoco.suggestion import did_you_mean
from deepkoco.yaml_file import YamlFileError, read_yaml, shown

SECTIONS = ("nodes", "connections", "correlations", "stalls", "parameters")
_ENTRIES = {"nodes": OF_A_NODE, "connections": OF_A_CONNECTION}
_KINDS: dict[str, type] = {
    "scheduling": str, "advance": bool, "window": int, "skip": bool, "blocking": bool, "jitter": str, "fifo": bool,
}  # fmt: skip
_FRACTION = re.compile(r"[0-9]{1,40}/[1-9][0-9]{0,39}")


class SetupError(ValueError):
    """A setup does not fit; the message names its place and says what is wrong."""


def write_setup(
    path: str | Path, graph: Graph, parameters: Mapping[str, Mapping[str, Any]] | None = None
) -> Path:
    """Write the setup of a graph as YAML, whole or not at all; arguments as for `describe_setup`.

    Raises:
        SetupError: the file exists.
        WriteError: the place cannot be written.
    """
    path = Path(path)
    if path.exists():
        raise SetupError(f"{path}: exists; choose another name or move it away")
    text = yaml.safe_dump(describe_setup(graph, parameters), sort_keys=False, allow_unicode=True, width=120)
    write_whole_text(path, f"# Setup of a graph: rates in Hz, delays and phases in s.\n{text}")
    return path


def read_setup(path: str | Path) -> dict[str, Any]:
    """Read a setup.

    Returns:
        Its sections, see `describe_setup`; each section and each entry may be missing.

    Raises:
        SetupError: it cannot be read, or an entry is not one of a setup.
    """
    try:
        content = read_yaml(path)
    except YamlFileError as error:
        raise SetupError(str(error)) from error
    try:
        return check_setup({} if content is None else content)
    except SetupError as error:
        raise SetupError(f"{path}: {error}") from error


def check_setup(content: Any) -> dict[str, Any]:
    """Check that plain values are a setup, whatever the graph is.

    Raises:
        SetupError: names the entry that is none.
    """
    whole = _mapping("the setup", content)
    _known("the setup", whole, SECTIONS)
    for section, known in _ENTRIES.items():
        for name, entry in _mapping(section, whole.get(section)).items():
            place = f"{section}: {name}"
            _known(place, _mapping(place, entry), known)
            for key, kind in _KINDS.items():
                if key in (entry or {}) and type(entry[key]) is not kind:
                    raise SetupError(f"{place}: {key}: {shown(entry[key])} is no {_WORDS[kind]}")
    for section in ("correlations", "stalls"):
        entries = whole.get(section)
        if entries is not None and not (
            isinstance(entries, list) and all(isinstance(each, Mapping) for each in entries)
        ):
            raise SetupError(f"{section}: {shown(entries)} is no list of descriptions")
    for node, values in _mapping("parameters", whole.get("parameters")).items():
        for name, value in _mapping(f"parameters: {node}", values).items():
            _check_numbers(f"parameters: {node}: {name}", value)
    return {section: whole[section] for section in SECTIONS if whole.get(section) is not None}


_WORDS: dict[type, str] = {str: "word", bool: "yes or no (true, false)", int: "whole number"}


def exact_number(place: str, value: Any) -> Fraction | float:
    """A number of a setup: a float, or a fraction "p/q".

    Raises:
        SetupError: it is neither.
    """
    if isinstance(value, str) and _FRACTION.fullmatch(value):
        return Fraction(value)
    try:
        if not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value):
            return value
    except OverflowError:  # a whole number beyond all floats
        pass
    raise SetupError(f"{place}: {shown(value)} is no number")


def _check_numbers(place: str, value: Any) -> None:
    for entry in value if isinstance(value, list) else (value,):
        if isinstance(entry, list):
            _check_numbers(place, entry)
        elif type(entry) not in (bool, int, float):
            raise SetupError(f"{place}: {shown(entry)} is no number")


def _mapping(place: str, value: Any) -> Mapping[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise SetupError(f"{place}: {shown(value)} is no table of names and values")
    return value


def _known(place: str, entries: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for name in entries:
        if name not in known:
            hint = did_you_mean(name, known) or f"; known: {', '.join(known)}"
            raise SetupError(f'{place}: there is no "{name}"{hint}')
