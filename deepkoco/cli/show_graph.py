"""`deepkoco show` of a file with a graph: its rates and delays, and a page on which they are edited."""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import TYPE_CHECKING, Any

from deepkoco.cli.input_error import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from deepkoco.graph.model.graph import Graph


def show_graph(args: argparse.Namespace) -> int:
    """Print the nodes and connections of a graph, and draw it if requested.

    Raises:
        InputError: The file or the setup cannot be used, or an output exists.
    """
    from deepkoco.graph.drawing import DrawingError, draw_graph, write_page
    from deepkoco.graph.model.node import GraphError
    from deepkoco.graph.net.graph_file import read_graph_file
    from deepkoco.graph.setup import SetupError, describe_setup
    from deepkoco.output.new_folder import new_folder
    from deepkoco.output.whole_file import writing
    from deepkoco.own_objects import OwnObjectError

    for target in (args.pictures, args.html):
        if target is not None and target.exists():
            raise InputError(f"{target}: exists; choose another name or move it away")
    try:
        file = read_graph_file(str(args.path), args.setup)
        graph, parameters = file.graph, file.parameters()
        if args.pictures is not None:
            with new_folder(args.pictures) as folder:
                draw_graph(graph).save(folder)
        if args.html is not None:
            with writing(args.html):
                args.html.parent.mkdir(parents=True, exist_ok=True)
            given = file if args.setup is None else read_graph_file(str(args.path))
            own = describe_setup(given.graph, given.parameters())
            write_page(args.html, graph, title=args.path.name, parameters=parameters, changed_from=own)
    except (OwnObjectError, SetupError, GraphError, DrawingError) as error:
        raise InputError(str(error)) from error
    if args.json:
        sys.stdout.write(json.dumps(_as_json(describe_setup(graph, parameters)), indent=2) + "\n")
        return 0
    from rich.console import Console

    console = Console()
    for table in tables(graph, str(args.path)):
        console.print(table)
    return 0


def _as_json(value: Any) -> Any:
    """Plain values for JSON, which has no infinity: it is written as text."""
    if isinstance(value, dict):
        return {key: _as_json(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_as_json(each) for each in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def tables(graph: Graph, title: str) -> tuple[Table, Table]:
    """Nodes and connections of a graph as tables for the terminal."""
    from rich.table import Table
    from rich.text import Text

    from deepkoco.graph.drawing.words import delay_words, graph_words

    nodes, connections = (
        Table(title=Text(text), title_justify="left", box=None, padding=(0, 1, 0, 0))
        for text in (f"{title} · {graph_words(graph)}", "")
    )
    for heading in ("node", "rate\nHz", "first tick\nms", "computes", "after an overrun"):
        nodes.add_column(heading, justify="left" if heading in ("node", "after an overrun") else "right")
    for node, phase in zip(graph.nodes, graph.phases, strict=True):
        late = "keeps the distance of its ticks" if node.scheduling == "frequency" else "catches up"
        cells = (f"{float(node.rate):.6g}", f"{1000 * float(phase):.4g}", delay_words(node.delay) or "0 ms")
        nodes.add_row(Text(node.name), *cells, late + (", advances" if node.advance else ""))
    for heading in ("connection", "delay", "window", ""):
        connections.add_column(heading, justify="right" if heading in ("delay", "window") else "left")
    for each in graph.connections:
        kinds = {
            "waits (blocking)": each.blocking,
            "for the next step (skip)": each.skip,
            "buffered": each.jitter == "buffer",
            "any order": not each.fifo,
        }
        words = ", ".join(word for word, so in kinds.items() if so)
        connections.add_row(Text(each.key), delay_words(each.law) or "0 ms", str(each.window), words)
    return nodes, connections
