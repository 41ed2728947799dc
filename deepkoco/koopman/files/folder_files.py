"""The two files of a model's folder, config.json and model.safetensors: written whole, read with suspicion."""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from deepkoco.output.new_folder import new_folder

Array = NDArray[np.float64]
WEIGHTS_FILE = "model.safetensors"
CONFIG_FILE = "config.json"
CARD_FILE = "README.md"
FORMAT = "deepkoco-model"
FORMAT_VERSION = 2
READ_VERSIONS = (1, 2)
CHECKSUMS = "checksums"
LARGEST_CONFIG = 1 << 20
LARGEST_WEIGHTS = 1 << 30
"""Most bytes of either file that are read."""


class ModelFolderError(ValueError):
    """A folder does not hold a readable exported model."""


def write_files(folder: Path, config: dict[str, Any], arrays: Mapping[str, Array], card: str) -> None:
    """Write the files of a model into a new folder, all or nothing, with format, version and checksums.

    Args:
        folder: Must not exist.
        config: Further plain values.
        arrays: Arrays by name.
        card: Text of README.md.

    Raises:
        ModelFolderError: The folder exists.
        WriteError: The disk is full, or the place cannot be written.
    """
    if folder.exists():
        raise ModelFolderError(f"{folder}: exists already; choose another folder")
    weights = save({name: np.ascontiguousarray(array) for name, array in arrays.items()})
    config = {"format": FORMAT, "version": FORMAT_VERSION, **config}
    config = {**config, CHECKSUMS: {CONFIG_FILE: _digest(config), WEIGHTS_FILE: _sha256(weights)}}
    with new_folder(folder) as partial:
        (partial / WEIGHTS_FILE).write_bytes(weights)
        (partial / CONFIG_FILE).write_text(
            json.dumps(config, indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )
        (partial / CARD_FILE).write_text(card, encoding="utf-8")


def read_files(folder: Path, root: Path | None = None) -> tuple[dict[str, Any], dict[str, Array]]:
    """Read the files of a model; nothing in them is run.

    Args:
        folder: The folder.
        root: Folder that links may not leave; None takes `folder`.

    Returns:
        config.json without its checksums, and the arrays in double precision, all finite.

    Raises:
        ModelFolderError: A file is missing, too large, damaged, was changed since it was written, or is of another
            format or version.
    """
    texts = {}
    for name, limit in ((CONFIG_FILE, LARGEST_CONFIG), (WEIGHTS_FILE, LARGEST_WEIGHTS)):
        texts[name] = _read_file(folder / name, limit, root or folder)
    config = _parse_config(texts[CONFIG_FILE], folder / CONFIG_FILE)
    if config.get("format") != FORMAT or config.get("version") not in READ_VERSIONS:
        raise ModelFolderError(
            f"{folder / CONFIG_FILE}: format {str(config.get('format'))[:50]!r} version "
            f"{str(config.get('version'))[:50]!r}; "
            f"this release reads {FORMAT!r} versions {' and '.join(map(str, READ_VERSIONS))}"
        )
    checksums = config.pop(CHECKSUMS, None)
    if checksums is not None:
        expected = {CONFIG_FILE: _digest(config), WEIGHTS_FILE: _sha256(texts[WEIGHTS_FILE])}
        for name, digest in expected.items():
            if not isinstance(checksums, dict) or checksums.get(name) != digest:
                raise ModelFolderError(
                    f"{folder / name}: damaged or changed since it was written, its checksum does not fit; "
                    "get the folder anew (settings of the planner can be given to load instead)"
                )
    elif config["version"] != 1:  # the first version had none
        raise ModelFolderError(f'{folder / CONFIG_FILE}: damaged, "{CHECKSUMS}" is missing')
    return config, _parse_weights(texts[WEIGHTS_FILE], folder / WEIGHTS_FILE)


def _read_file(path: Path, limit: int, root: Path) -> bytes:
    """The bytes of a regular file inside a folder."""
    try:
        resolved = path.resolve(strict=True)
        inside = resolved.is_relative_to(root.resolve(strict=True))
    except (OSError, RuntimeError, ValueError) as error:
        raise ModelFolderError(
            f"{path.parent}: no {path.name}; give the folder of a finished training run, or of an exported model"
        ) from error
    if not inside:
        raise ModelFolderError(f"{path}: a link that leaves its folder; copy the file itself")
    try:
        # Not blocking: a named pipe in the place of the file would wait for a writer forever.
        descriptor = os.open(resolved, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with open(descriptor, "rb") as file:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise ModelFolderError(f"{path}: not a file; give the folder of an exported model")
            if status.st_size > limit:
                raise ModelFolderError(f"{path}: has {status.st_size} bytes; at most {limit} are read")
            return file.read(limit + 1)[:limit]
    except OSError as error:
        raise ModelFolderError(f"{path}: cannot be read: {error.strerror}") from error


def _parse_config(text: bytes, path: Path) -> dict[str, Any]:
    """JSON with unique names and finite numbers only."""

    def number(literal: str) -> float:
        value = float(literal)
        if not math.isfinite(value):
            raise ValueError(f"{literal[:20]} is no finite number")
        return value

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        entries = dict(pairs)
        if len(entries) != len(pairs):
            raise ValueError("a name is given twice")
        return entries

    try:
        config = json.loads(
            text.decode("utf-8"), parse_float=number, parse_constant=number, object_pairs_hook=unique
        )
    except (ValueError, RecursionError) as error:
        raise ModelFolderError(f"{path}: damaged, it is not JSON: {str(error)[:200]}") from error
    if not isinstance(config, dict):
        raise ModelFolderError(f"{path}: damaged, it does not hold named entries")
    return config


def _parse_weights(data: bytes, path: Path) -> dict[str, Array]:
    """Finite arrays in double precision."""
    try:
        arrays = load(data)
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        raise ModelFolderError(f"{path}: damaged: {str(error)[:200]}") from error
    for name, array in arrays.items():
        if array.dtype not in (np.float32, np.float64):
            raise ModelFolderError(f"{path}: {name[:100]!r} holds {array.dtype}, not float32 or float64")
        if not np.isfinite(array).all():
            raise ModelFolderError(f"{path}: {name[:100]!r} holds numbers that are not finite")
    return {name: array.astype(np.float64) for name, array in arrays.items()}


def _digest(config: dict[str, Any]) -> str:
    """Checksum of the entries, whatever their order and spacing in the file."""
    return _sha256(json.dumps(config, sort_keys=True, separators=(",", ":")).encode())


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
