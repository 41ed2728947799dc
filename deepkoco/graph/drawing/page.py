"""One self-contained page for a graph and, if wanted, an episode of it: to move, hover and zoom into."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.graph.drawing.layers import Placement, Size, place
from deepkoco.graph.drawing.setup_form import setup_form
from deepkoco.graph.drawing.signals import MOST_ENTRIES, draw_signals, signals_of
from deepkoco.graph.drawing.style import PALETTE, DrawingError, write_whole
from deepkoco.graph.drawing.words import connection_words, delay_words, graph_words, loop_words, node_words
from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.storage.summary import Spread, summarise_episodes
from deepkoco.graph.episodes.tables import steps_table
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph
from deepkoco.output import picture
from deepkoco.pages.figures import Shown, show_both
from deepkoco.pages.links import links_between
from deepkoco.pages.page import render_page, software

MOST_STEPS = 20_000
"""Steps of an episode that a page holds; a longer one is cut."""
_PIXELS = 96.0  # per inch
_NAME, _SMALL = 8.7, 6.4  # width of a character [px], bold 15 px and 12 px
_LINE, _EDGE = 17, 20  # height of a line, empty space around [px]


def write_page(
    path: str | Path,
    graph: Graph,
    episode: Episode | None = None,
    title: str = "Graph",
    pages: Mapping[str, Path] | None = None,
    made: date | None = None,
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
    changed_from: dict[str, Any] | None = None,
) -> Path:
    """Write the page, whole or not at all.

    Args:
        path: file to write.
        graph: what is shown.
        episode: shown as timeline, numbers and signals below; of a long one the timeline has the beginning.
        title: heading.
        pages: name to file of other pages that may be there, for the navigation.
        made: day that the page says; None takes today's, or that of SOURCE_DATE_EPOCH.
        parameters: by node and name, to be edited with rates and delays, see `describe_setup`.
        changed_from: setup that the graph has without the changes that it came with; the page saves these, too.

    Raises:
        DrawingError: the file exists.
    """
    path = Path(path)
    if path.exists():
        raise DrawingError(f"{path}: exists; choose another name or move it away")
    page = make_page(graph, episode, title, path, pages, made, parameters, changed_from)
    write_whole(path, lambda file: file.write(page.encode()))
    return path


def make_page(
    graph: Graph,
    episode: Episode | None = None,
    title: str = "Graph",
    path: Path | None = None,
    pages: Mapping[str, Path] | None = None,
    made: date | None = None,
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
    changed_from: dict[str, Any] | None = None,
) -> str:
    """Return the page as text; arguments as for `write_page`."""
    placed = _place(graph)
    timeline = None if episode is None else _timeline(graph, episode)
    nodes, edges = _nodes(graph, placed), [_edge(c, placed) for c in graph.connections]
    own = path or Path("graph.html")
    form = setup_form(graph, parameters, changed_from)
    return render_page(
        "deepkoco.graph.drawing",
        "pages/page.html",
        title=title,
        versions=software("torch", "numpy"),
        made=made,
        links=links_between(own, {**(pages or {}), "Graph": own}),
        summary=graph_words(graph),
        width=round(placed.width * _PIXELS) + 2 * _EDGE,
        height=round(placed.height * _PIXELS) + 2 * _EDGE,
        nodes=nodes,
        edges=edges,
        timeline=timeline,
        numbers=None if episode is None else _numbers(graph, episode),
        signals=None if episode is None else _signals(graph, episode),
        form=form,
        data={"nodes": nodes, "edges": edges, "timeline": timeline, "form": form},
    )


def _numbers(graph: Graph, episode: Episode) -> dict[str, list[dict[str, Any]]]:
    """Rates and delays of an episode as they are written in tables."""
    summary = summarise_episodes(graph, [episode])
    nodes = [
        {
            "name": n.name,
            "cells": [
                str(n.steps),
                f"{n.rate_hz:.6g}",
                "–" if n.realised_hz is None else f"{n.realised_hz:.2f}",
                *_spread(n.computation),
            ],
            "alarms": [n.overruns, n.late],
        }
        for n in summary.nodes
    ]
    connections = [
        {"name": c.key, "cells": [str(c.messages), *_spread(c.communication)], "alarms": [c.lost]}
        for c in summary.connections
    ]
    return {"nodes": nodes, "connections": connections}


def _spread(delay: Spread) -> list[str]:
    values = (delay.mean_s, delay.p50_s, delay.p99_s)
    return ["–" if value is None else f"{1000 * value:.2f}" for value in values]


def _signals(graph: Graph, episode: Episode) -> Shown | None:
    """The outputs over time; the numbers behind them go with the page as a file to save."""
    if not signals_of(graph, episode):
        return None
    drawn = draw_signals(graph, episode)
    caption = (
        f"What every node sent, at the moment it sent it; a value holds until the next. Outputs of more than "
        f"{MOST_ENTRIES} numbers, such as pictures, are left out."
    )
    table = drawn.table.to_csv(index=False, float_format="%.6g").encode()
    numbers = f"data:text/csv;base64,{base64.b64encode(table).decode()}"
    return show_both(picture.Picture("signals", "Signals", caption, drawn.figure, drawn.table), numbers)


def _place(graph: Graph) -> Placement:
    sizes = {}
    for node in graph.nodes:
        below = node_words(node) + loop_words(graph, node)
        width = max(_NAME * len(node.name), *(_SMALL * len(line) for line in below)) + 28
        sizes[node.name] = Size(width / _PIXELS, (_LINE * (1 + len(below)) + 18) / _PIXELS)
    labels = {}
    for c in graph.connections:
        words = connection_words(c)
        if words:
            width = max(len(line) for line in words) * _SMALL + 12
            labels[c.key] = Size(width / _PIXELS, (15 * len(words) + 4) / _PIXELS)
    return place(graph, sizes, labels)


def _nodes(graph: Graph, placed: Placement) -> list[dict[str, Any]]:
    nodes = []
    for n, node in enumerate(graph.nodes):
        box = placed.boxes[node.name]
        facts = {
            "rate": f"{float(node.rate):.6g} Hz",
            "first tick at": f"{1000 * float(graph.phases[n]):.4g} ms",
            "computation": delay_words(node.delay) or "no delay",
            "scheduling": node.scheduling + (", advances" if node.advance else ""),
        }
        nodes.append(
            {
                "name": node.name,
                "colour": PALETTE[n % len(PALETTE)],
                "supervises": node.name == graph.supervisor,
                "x": round(box.x * _PIXELS + _EDGE, 1),
                "y": round((placed.height - box.y) * _PIXELS + _EDGE, 1),
                "w": round(box.width * _PIXELS, 1),
                "h": round(box.height * _PIXELS, 1),
                "lines": node_words(node) + loop_words(graph, node),
                "facts": list(facts.items()),
            }
        )
    return nodes


def _edge(connection: Connection, placed: Placement) -> dict[str, Any]:
    route = placed.routes.get(connection.key, np.zeros((0, 2)))
    points = np.stack([route[:, 0], placed.height - route[:, 1]], axis=1) * _PIXELS + _EDGE
    label = placed.labels.get(connection.key)
    facts = {
        "delay": delay_words(connection.law) or "none",
        "window": f"last {connection.window}" if connection.window > 1 else "last message",
        "the receiver": "waits for it (blocking)" if connection.blocking else "takes what is there",
    }
    if connection.skip:
        facts["skip"] = "a message of the same instant is for the next step"
    if connection.jitter == "buffer":
        facts["jitter buffer"] = "not before the nominal arrival"
    if not connection.fifo:
        facts["order"] = "messages may overtake each other"
    return {
        "key": connection.key,
        "sender": connection.sender,
        "receiver": connection.receiver,
        "skip": connection.skip,
        "blocking": connection.blocking,
        "points": points.round(1).tolist(),
        "lines": connection_words(connection),
        "label": None
        if label is None
        else [
            round(label.x * _PIXELS + _EDGE, 1),
            round((placed.height - label.y) * _PIXELS + _EDGE, 1),
            round(label.width * _PIXELS, 1),
            round(label.height * _PIXELS, 1),
        ],
        "facts": list(facts.items()),
    }


def _timeline(graph: Graph, episode: Episode) -> dict[str, Any]:
    """Steps by node and what they saw; times rounded to 0.1 us, of an arrival that never came null."""
    steps = steps_table(graph, episode).sort_values("t_start_s", kind="stable")
    cut = len(steps) > MOST_STEPS
    last = float(np.max(steps["t_end_s"].to_numpy(), initial=0.0))
    until = float(steps["t_start_s"].to_numpy()[MOST_STEPS]) if cut else last
    lanes = []
    for position in graph.order:
        node = graph.nodes[position]
        kept = episode.t_start[node.name] <= until
        mine = steps.loc[steps["node"] == node.name].sort_values("seq")[: int(kept.sum())]
        seen = []
        for c in graph.inputs_of(node.name):
            if c.key in episode.windows:
                windows = episode.windows[c.key][: len(mine)]
                known = int(windows.max(initial=-1)) + 1
                sent, received = episode.t_sent[c.key][:known], episode.t_received[c.key][:known]
                seen.append(
                    {
                        "sender": c.sender,
                        "key": c.key,
                        "windows": windows.tolist(),
                        "sent": sent.round(7).tolist(),
                        "received": [t if np.isfinite(t) else None for t in received.round(7).tolist()],
                    }
                )
        lanes.append(
            {
                "name": node.name,
                "colour": PALETTE[position % len(PALETTE)],
                "start": mine["t_start_s"].round(7).tolist(),
                "end": mine["t_end_s"].round(7).tolist(),
                "overrun": mine["overrun"].astype(int).tolist(),
                "late": mine["late_s"].round(7).tolist(),
                "inputs": seen,
            }
        )
    acts = episode.t_start[graph.supervisor]
    return {
        "lanes": lanes,
        "supervisor": graph.supervisor,
        "until": until,
        "first": float(acts[min(6, len(acts) - 1)]) if len(acts) > 1 else until,
        "cut": f"the first {until:.3g} s of {last:.4g} s" if cut else "",
    }
