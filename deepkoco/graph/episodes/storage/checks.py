"""Checks of what a recording holds: every entry that is read has its type, its range and its meaning."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from deepkoco.graph.episodes.storage.messages import LEVELS
from deepkoco.graph.model.graph import Graph

LARGEST_SEQ = 2**31 - 1
LATEST_NS = 2**63 - 1
MOST_AXES = 32
_DTYPE = re.compile(r"[<>|=]?([biufc])([0-9]{1,2})")
_WHOLE = re.compile(r"-?[0-9]{1,19}")
_OUTPUT = ("dtype", "shape", "values", "raw")


class ContentError(ValueError):
    """An entry of a recording is not what it must be; the message names the entry."""


def _no_constant(name: str) -> float:
    raise ContentError(f"{name} is no number of JSON")


_DECODER = json.JSONDecoder(parse_constant=_no_constant)


def json_object(text: bytes | str, what: str) -> dict[str, Any]:
    """Parse a JSON object.

    Raises:
        ContentError: it is none.
    """
    try:
        content = _DECODER.decode(text.decode("utf-8") if isinstance(text, bytes) else text)
    except ContentError as error:
        raise ContentError(f"{what}: {error}") from error
    except RecursionError as error:
        raise ContentError(f"{what} is nested too deep") from error
    except ValueError as error:
        raise ContentError(f"{what} is not JSON: {str(error)[:200]}") from error
    if not isinstance(content, dict):
        raise ContentError(f"{what} holds no named entries")
    return content


def whole(content: Mapping[str, Any], name: str, low: int = 0, high: int = LARGEST_SEQ) -> int:
    """Return an entry that is a whole number from `low` to `high`.

    Raises:
        ContentError: it is missing or something else.
    """
    value = _entry(content, name)
    if type(value) is not int or not low <= value <= high:
        raise ContentError(f"{name} {_shown(value)} is no whole number from {low} to {high}")
    return value


def finite(content: Mapping[str, Any], name: str) -> float:
    """Return an entry that is a finite number.

    Raises:
        ContentError: it is missing or something else.
    """
    value = _entry(content, name)
    if type(value) not in (int, float) or not abs(value) <= sys.float_info.max:
        raise ContentError(f"{name} {_shown(value)} is no finite number")
    return value


def decimal(content: Mapping[str, str], name: str, low: int, high: int) -> int:
    """Return an entry of a metadata record that is a whole number, which such records write as text.

    Raises:
        ContentError: it is missing or something else.
    """
    text = _entry(content, name)
    if not _WHOLE.fullmatch(text) or not low <= int(text) <= high:
        raise ContentError(f"{name} {_shown(text)} is no whole number from {low} to {high}")
    return int(text)


def text_entry(content: Mapping[str, Any], name: str) -> str:
    """Return an entry that is text.

    Raises:
        ContentError: it is missing or something else.
    """
    value = _entry(content, name)
    if not isinstance(value, str):
        raise ContentError(f"{name} {_shown(value)} is no text")
    return value


def check_step(content: Mapping[str, Any], windows: Mapping[str, int]) -> None:
    """Check a step of a node.

    Args:
        content: the message.
        windows: by input name, how many messages a step sees.

    Raises:
        ContentError: an entry is wrong.
    """
    whole(content, "seq")
    start, end = finite(content, "t_start"), finite(content, "t_end")
    _check_same(content, "duration", end - start)
    inputs = _entry(content, "inputs")
    if not isinstance(inputs, dict):
        raise ContentError(f"inputs {_shown(inputs)} are no named entries")
    for name, seen in inputs.items():
        if name not in windows:
            raise ContentError(f'"{name[:50]}" is no input; known: {", ".join(windows) or "none"}')
        size = windows[name]
        right = isinstance(seen, list) and len(seen) == size
        if not right or not all(type(seq) is int and -size <= seq <= LARGEST_SEQ for seq in seen):
            raise ContentError(f'input "{name}" {_shown(seen)} is no list of the {size} steps that are seen')
    if any(name in content for name in _OUTPUT):
        _check_output(content)


def check_message(content: Mapping[str, Any]) -> None:
    """Check a message of a connection.

    Raises:
        ContentError: an entry is wrong.
    """
    whole(content, "seq")
    sent = finite(content, "t_sent")
    lost = _entry(content, "lost")
    if not isinstance(lost, bool):
        raise ContentError(f"lost {_shown(lost)} is neither true nor false")
    if lost == ("t_received" in content):
        raise ContentError(f"lost is {str(lost).lower()}, and t_received is {'' if lost else 'not '}there")
    if not lost:
        _check_same(content, "delay", finite(content, "t_received") - sent)


def check_note(content: Mapping[str, Any]) -> None:
    """Check a remark.

    Raises:
        ContentError: an entry is wrong.
    """
    finite(content, "t")
    whole(content, "level", min(LEVELS.values()), max(LEVELS.values()))
    for name in ("name", "message"):
        if not isinstance(_entry(content, name), str):
            raise ContentError(f"{name} {_shown(content[name])} is no text")


def check_extent(extent: Mapping[str, Any], graph: Graph) -> None:
    """Check how far an episode goes: steps by node, messages by connection, and its end [s].

    Raises:
        ContentError: an entry is wrong, missing or too much.
    """
    for what, names in (("steps", list(graph.index)), ("messages", [c.key for c in graph.connections])):
        counts = _entry(extent, what)
        if not isinstance(counts, dict) or set(counts) != set(names):
            raise ContentError(f"{what} {_shown(counts)} are not counts of {', '.join(names)}")
        for name in names:
            whole(counts, name)
    if extent["steps"][graph.supervisor]:
        finite(extent, "last_end")
    elif _entry(extent, "last_end") is not None:
        raise ContentError("last_end is given of a supervisor that made no step")


def _check_same(content: Mapping[str, Any], name: str, value: float) -> None:
    """Check an entry for viewers, which says again what two others say."""
    if content.get(name, value) != value:
        raise ContentError(f"{name} {_shown(content[name])} is not the difference of its times, {value}")


def _check_output(content: Mapping[str, Any]) -> None:
    dtype, shape = _entry(content, "dtype"), _entry(content, "shape")
    match = _DTYPE.fullmatch(dtype) if isinstance(dtype, str) else None
    try:
        kind = np.dtype(dtype) if match else None
    except TypeError:
        kind = None
    if match is None or kind is None:
        raise ContentError(f"dtype {_shown(dtype)} is no type of numbers")
    right = isinstance(shape, list) and len(shape) < MOST_AXES
    if not right or not all(type(size) is int and 0 <= size <= LARGEST_SEQ for size in shape):
        raise ContentError(f"shape {_shown(shape)} is no list of sizes")
    count = math.prod(shape)
    if "raw" in content:
        raw = content["raw"]
        if not isinstance(raw, str) or len(raw) != 4 * ((count * kind.itemsize + 2) // 3):
            raise ContentError(f"raw does not hold the {count} numbers of shape {shape}")
        return
    values = _entry(content, "values")
    if not isinstance(values, list) or len(values) != count:
        raise ContentError(f"values {_shown(values)} are not the {count} numbers of shape {shape}")
    if not values:
        return
    types = set(map(type, values))
    if kind.kind in "biu":
        limits = np.iinfo(np.uint8 if kind.kind == "b" else kind)
        low, high = (0, 1) if kind.kind == "b" else (int(limits.min), int(limits.max))
        fits = types == {int} and low <= min(values) and max(values) <= high
    else:
        fits = kind.kind == "f" and types <= {int, float} and bool(np.isfinite(_cast(values, kind)).all())
    if not fits:
        raise ContentError(f"values {_shown(values)} are no numbers of dtype {dtype}")


def _cast(values: list[float], dtype: np.dtype) -> np.ndarray:
    try:
        with np.errstate(over="ignore"):
            return np.array(values, dtype=dtype)
    except OverflowError:
        return np.array([np.inf])


def _entry(content: Mapping[str, Any], name: str) -> Any:
    if name not in content:
        raise ContentError(f"{name} is missing")
    return content[name]


def _shown(value: Any) -> str:
    text = repr(value)[:80]
    return text if len(text) < 80 else f"{text}..."
