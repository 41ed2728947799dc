"""The file model.yaml: a system, its effects, and the values of its parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems.effects.elastic import ELASTIC
from deepkoco.systems.elastic_drive import ElasticDrive
from deepkoco.systems.extended import ExtendedSystem
from deepkoco.systems.origins import find_stored, origin_of, stored_origin
from deepkoco.systems.registry import SYSTEMS, UnknownSystemError, make_system
from deepkoco.systems.system import System
from deepkoco.yaml_file import YamlFileError, read_yaml

MODEL_VERSION = 1


class ModelFileError(ValueError):
    """A model.yaml cannot be read."""


def save_model(path: str | Path, system: System, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a system as model.yaml, atomically.

    Args:
        path: File to write.
        system: Plain or extended system.
        provenance: Where it comes from (log, verdict, version), stored beside it.

    Raises:
        FileExistsError: The file is there already.
        WriteError: The disk is full, or the place cannot be written.
    """
    path = Path(path)
    if path.exists():
        raise FileExistsError(f"{path} exists; choose another name")
    base = system.base if isinstance(system, ExtendedSystem) else system
    effects = [e.name for e in system.effects] if isinstance(system, ExtendedSystem) else []
    learned = [e for e in effects if e.split("(")[0] == "learned"]
    origin = origin_of(base)
    document = {
        "version": MODEL_VERSION,
        "system": base.name,
        **({} if origin is None else {"origin": stored_origin(origin, path.parent)}),
        **({} if system.engine is None else {"engine": system.engine, "engine_step": system.engine_step}),
        "effects": effects,
        # Fitted to data, without a mechanism behind it: for readers of the file.
        **({"learned": learned} if learned else {}),
        "parameters": {p.name: {"value": p.value, "unit": p.unit} for p in system.parameters},
        "provenance": dict(provenance or {}),
    }
    write_whole_text(path, yaml.safe_dump(document, sort_keys=False))


def load_model(path: str | Path) -> ExtendedSystem:
    """Read a system from model.yaml.

    The key ``origin`` names the class or file of a system that is not the package's: a relative path is looked for
    from the folder of model.yaml, then from the current folder. A file of Python is imported, so its code runs.

    Raises:
        ModelFileError: The file is missing, is not YAML, or does not describe a known system.
    """
    path = Path(path)
    try:
        document = read_yaml(path)
    except YamlFileError as error:
        raise ModelFileError(str(error)) from error
    if not isinstance(document, dict) or document.get("version") != MODEL_VERSION:
        raise ModelFileError(f"{path}: not a model file of version {MODEL_VERSION}")
    try:
        values = {name: float(entry["value"]) for name, entry in document["parameters"].items()}
        base = _base_of(document, path)
        base = _in_engine(document, base)
        if any(str(effect).split("(")[0] == ELASTIC.name for effect in document["effects"]):
            base = ElasticDrive(base)
        system = ExtendedSystem(base, tuple(document["effects"]), values)
    except (KeyError, TypeError, AttributeError) as error:
        raise ModelFileError(f"{path}: misses or garbles the entry {error}") from error
    except ValueError as error:
        raise ModelFileError(f"{path}: {error}") from error
    system.source = path
    return system


def _in_engine(document: dict[str, Any], base: System) -> System:
    """The system as an engine simulates it; without one, as a real machine moves.

    Raises:
        ValueError: The system's file is of no such engine, or the step is none.
    """
    name, step = document.get("engine"), document.get("engine_step")
    if name is None:
        if step is not None:
            raise ValueError(
                "engine_step: a machine has no steps; name the engine too, or leave this key out"
            )
        return base
    number = isinstance(step, float | int) and not isinstance(step, bool)
    if step is not None and not (number and math.isfinite(step) and step >= 0.0):
        raise ValueError(
            f"engine_step: {step!r} is no time in s (0.0002 or 2.0e-4); leave this key out for the step of the file"
        )
    found = base.with_engine(name, None if step is None else float(step))
    if found is None or found.engine != name:
        raise ValueError(f'engine: {base.name} is simulated by no "{name}"; leave this key out')
    return found


def _base_of(document: dict[str, Any], path: Path) -> System:
    """The system that a model file extends: by its name, or where the file says that it comes from.

    Raises:
        ModelFileError: The system has another name now.
        UnknownSystemError: It is not found.
    """
    name, origin = document["system"], document.get("origin")
    registered = SYSTEMS.get(name)
    if registered is not None and not registered.__module__.startswith("deepkoco."):
        return make_system(name)
    if origin is None:
        try:
            return make_system(name)
        except UnknownSystemError as error:
            raise UnknownSystemError(
                f"{error}; one of your own: deepkoco.register_system(CLASS) first"
            ) from error
    if not isinstance(origin, str):
        raise TypeError("origin")
    base = find_stored(origin, path.parent)
    if base.name != name:
        raise ModelFileError(
            f"{path}: is a model of {name}, and {origin} is called {base.name} now; give it its name back"
        )
    return base
