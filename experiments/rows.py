"""Rows of a study that may be stopped: kept as JSON lines, each with the sources and commit that it was made from."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import deepkoco
from deepkoco.output.whole_file import writing
from experiments.provenance import provenance


@cache
def source_digest(packages: tuple[str, ...] = ("",), beside: tuple[str, ...] = ()) -> str:
    """Digest of the Python sources below these folders of the package, and of files or folders beside this one."""
    digest = hashlib.sha256()
    for root, names in (
        (Path(deepkoco.__file__).resolve().parent, packages),
        (Path(__file__).resolve().parent, beside),
    ):
        for name in names:
            place = (root / name).resolve()
            if not place.exists():
                raise FileNotFoundError(f"{place}: no such source; a digest would not see its changes")
            for path in [place] if place.is_file() else sorted(place.rglob("*.py")):
                digest.update(f"{path.relative_to(root.parent)}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def origin(source: str) -> dict[str, str]:
    """What a row says about where it comes from: commit, and digest of the sources."""
    return {"commit": provenance()["commit"], "source": source}


def read_rows(path: Path | None) -> list[dict[str, Any]]:
    """Rows of a file of JSON lines; none if it is not there, the last left out where it was cut off."""
    if path is None or not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").split("\n")
    return [json.loads(line) for line in lines[:-1]]


def append_row(path: Path | None, row: Mapping[str, Any]) -> None:
    """Add a row; what a kill left of a line before it is taken off first."""
    if path is None:
        return
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with writing(path), path.open("ab+") as file:
        file.seek(0)
        whole = file.read()
        file.truncate(whole.rfind(b"\n") + 1)
        file.write(json.dumps(row).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())
