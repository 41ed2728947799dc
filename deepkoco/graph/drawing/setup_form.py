"""What the page of a graph needs to edit its setup: values, and which numbers each delay law takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, get_type_hints

from deepkoco.graph.delay import LAWS, Delay
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import SCHEDULINGS
from deepkoco.graph.setup.describe import describe_setup

_KINDS = {float: "number", tuple[float, ...]: "numbers", Delay: "delay", tuple[Delay, ...]: "delays"}
_FIRST = {"number": 0.01, "numbers": [0.01, 0.02], "delay": {"law": "gaussian", "loc": 0.01, "scale": 0.002}}
_FIRST["delays"] = [_FIRST["delay"], {"law": "gaussian", "loc": 0.03, "scale": 0.005}]


def setup_form(
    graph: Graph,
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
    changed_from: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the setup of a graph with what is needed to edit it.

    Args:
        graph, parameters: as for `describe_setup`.
        changed_from: setup that the graph has without the changes that it came with; None: it came without any.

    Returns:
        ``start`` as `describe_setup` returns it, and ``setup``, from which changes are counted. ``laws``, by name of a
        delay law, its entries: name, kind ("number", "numbers", "delay", "delays" or "other") and the value with which
        a new law begins. ``schedulings`` and ``jitters``, the choices there are.
    """
    start = describe_setup(graph, parameters)
    return {
        "setup": start if changed_from is None else changed_from,
        "start": start,
        "laws": {name: _entries(law) for name, law in sorted(LAWS.items())},
        "schedulings": list(SCHEDULINGS),
        "jitters": ["latest", "buffer"],
    }


def _entries(law: type[Delay]) -> list[dict[str, Any]]:
    kinds = get_type_hints(law)
    entries = []
    for entry in fields(law):  # pyright: ignore[reportArgumentType]
        if not entry.init:
            continue
        kind = _KINDS.get(kinds[entry.name], "other")
        first = _FIRST.get(kind) if entry.default is MISSING else entry.default
        entries.append({"name": entry.name, "kind": kind, "first": first})
    return entries
