"""Messages of a recording: what each topic holds, as JSON that is exact and that a viewer can plot.

Numbers in JSON are written with as many digits as float64 needs to come back bit for bit. What JSON
cannot say (NaN and infinity, complex numbers) and what it says badly (images) goes along as raw bytes.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from deepkoco.graph.model.graph import Graph

MOST_VALUES = 1024
"""Outputs with more numbers than this are stored as raw bytes alone."""
LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4, "fatal": 5}

_exact = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


def encode(content: Mapping[str, Any]) -> bytes:
    """Write a message as JSON.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    return _exact(content).encode()


def output_fields(output: np.ndarray) -> dict[str, Any]:
    """Fields that hold an output bit for bit, with its dtype and shape."""
    fields: dict[str, Any] = {"dtype": output.dtype.str, "shape": output.shape}
    plain = output.size <= MOST_VALUES and output.dtype.kind in "biuf" and output.dtype.itemsize <= 8
    if plain and (output.dtype.kind != "f" or np.isfinite(output).all()):
        values = output.astype(np.uint8) if output.dtype.kind == "b" else output
        return fields | {"values": values.ravel().tolist()}
    if plain:
        # Shown in a viewer with gaps; read back from the bytes, which keep even the payload of a NaN.
        fields["values"] = [value if np.isfinite(value) else None for value in output.ravel().tolist()]
    return fields | {"raw": base64.b64encode(output.tobytes()).decode()}


def stack_outputs(messages: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Put the outputs of a node's steps together, (K, ...), from what `output_fields` made.

    Raises:
        ValueError: dtype or shape change from step to step.
    """
    dtype, shape = np.dtype(messages[0]["dtype"]), messages[0]["shape"]
    for message in messages:
        if message["dtype"] != messages[0]["dtype"] or message["shape"] != shape:
            raise ValueError(
                f"output of step {message['seq']} is {message['dtype']} {message['shape']}, before it was "
                f"{dtype.str} {shape}"
            )
    if not any("raw" in message for message in messages):
        return np.array([message["values"] for message in messages], dtype=dtype).reshape(
            len(messages), *shape
        )
    stacked = np.empty((len(messages), *shape), dtype=dtype)
    for place, message in enumerate(messages):
        if "raw" in message:
            stacked[place] = np.frombuffer(
                base64.b64decode(message["raw"], validate=True), dtype=dtype
            ).reshape(shape)
        else:
            stacked[place] = np.array(message["values"], dtype=dtype).reshape(shape)
    return stacked


def step_schema(graph: Graph, node: str) -> dict[str, Any]:
    """JSON schema of the steps of a node; `inputs` names what it sees."""
    seen = {
        str(connection.name): _list("integer", f"steps of {connection.sender} that it sees, oldest first")
        for connection in graph.inputs_of(node)
    }
    return _object(
        f"One step of {node}.",
        episode=_field("integer", "number of the episode in this file"),
        seq=_field("integer", "number of the step in the episode"),
        t_start=_field("number", "start since the episode began [s]"),
        t_end=_field("number", "end since the episode began [s]"),
        duration=_field("number", "t_end - t_start [s]"),
        inputs={"type": "object", "properties": seen},
        dtype=_field("string", "type of the output"),
        shape=_list("integer", "shape of the output"),
        values=_list("number", "output, last axis fastest; empty or null where only `raw` has it"),
        raw=_field("string", "output as bytes", contentEncoding="base64"),
    )


def message_schema(connection: str) -> dict[str, Any]:
    """JSON schema of the messages of a connection."""
    return _object(
        f"One message on {connection}.",
        episode=_field("integer", "number of the episode in this file"),
        seq=_field("integer", "step of the sender that sent it"),
        t_sent=_field("number", "since the episode began [s]"),
        t_received=_field("number", "since the episode began [s]; absent: it never arrived"),
        delay=_field("number", "t_received - t_sent [s]"),
        lost=_field("boolean", "whether it never arrived"),
    )


def note_schema() -> dict[str, Any]:
    """JSON schema of remarks: the one that log panels of viewers know, with the exact time beside it."""
    return _object(
        "A remark about a run.",
        timestamp={
            "type": "object",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        level=_field("integer", "1 debug, 2 info, 3 warning, 4 error, 5 fatal"),
        message=_field("string", "what happened"),
        name=_field("string", "node; empty: the whole run"),
        file=_field("string", "not used"),
        line=_field("integer", "not used"),
        episode=_field("integer", "number of the episode in this file"),
        t=_field("number", "since the episode began [s]"),
    )


def _object(description: str, **properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "description": description, "properties": properties}


def _field(kind: str, description: str, **more: str) -> dict[str, Any]:
    return {"type": kind, "description": description, **more}


def _list(kind: str, description: str) -> dict[str, Any]:
    return {"type": "array", "description": description, "items": {"type": kind}}
