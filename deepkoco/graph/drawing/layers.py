"""Where nodes and connections of a graph go on paper: in layers, by the flow of data.

Boxes stand in even columns, labels of connections in odd ones. A connection takes a place of its own in
every column that it passes, its label in the middle one, so that nothing lies on anything else.

Source: Sugiyama, Tagawa, Toda, Methods for visual understanding of hierarchical system structures (1981).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import isotonic_regression

from deepkoco.graph.model.graph import Graph

_SWEEPS = 24
_STRAIGHT = 8.0
_PASSING = 0.16  # height of a place where a connection only passes [in]
_GAP = 0.16  # between two places of a column [in]
_GUTTER = 0.30  # between two columns [in]


class Size(NamedTuple):
    """Width and height [in]."""

    width: float
    height: float


class Box(NamedTuple):
    """Centre and size [in]."""

    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class Placement:
    """A graph on paper; x to the right, y upwards [in].

    Attributes:
        boxes: by node name.
        labels: by connection key, place of its label; a connection of a node with itself has none.
        routes: by connection key, points that it passes, (n, 2), from sender to receiver.
        layer: by node name, its column among the boxes.
        width, height: of everything; the lower left corner is (0, 0).
    """

    boxes: dict[str, Box]
    labels: dict[str, Box]
    routes: dict[str, np.ndarray]
    layer: dict[str, int]
    width: float
    height: float


def assign_layers(graph: Graph) -> dict[str, int]:
    """Put every node right of all nodes that it hears from, except over feedback.

    A skipped connection counts as feedback if data flows from its receiver to its sender.

    Returns:
        Layer by node name, from 0.
    """
    after = _flow(graph)
    layer = dict.fromkeys(graph.index, 0)
    order = _order(after)
    for name in order:
        for successor in after[name]:
            layer[successor] = max(layer[successor], layer[name] + 1)
    heard = {successor for successors in after.values() for successor in successors}
    for name in reversed(order):
        if name not in heard and after[name]:  # a source stands next to those who need it
            layer[name] = min(layer[successor] for successor in after[name]) - 1
    return layer


def place(graph: Graph, sizes: Mapping[str, Size], label_sizes: Mapping[str, Size]) -> Placement:
    """Place boxes, labels and connections.

    Args:
        graph: what is drawn.
        sizes: of the boxes, by node name.
        label_sizes: of the labels, by connection key; a missing one has no label.
    """
    layer = assign_layers(graph)
    columns: list[list[str]] = [[] for _ in range(2 * max(layer.values()) + 1)]
    heights, widths = {}, {}
    for name in graph.index:
        columns[2 * layer[name]].append(f"node {name}")
        heights[f"node {name}"], widths[f"node {name}"] = sizes[name].height, sizes[name].width
    chains: dict[str, list[str]] = {}
    for connection in graph.connections:
        first, last = 2 * layer[connection.sender], 2 * layer[connection.receiver]
        if first == last:
            continue  # with itself
        step = 1 if first < last else -1
        passed = list(range(first + step, last, step))
        middle = passed[len(passed) // 2 - (len(passed) > 1 and passed[len(passed) // 2] % 2 == 0)]
        chains[connection.key] = []
        for column in passed:
            item = f"passes {connection.key} {column}"
            columns[column].append(item)
            size = label_sizes.get(connection.key) if column == middle else None
            heights[item] = _PASSING if size is None else size.height
            widths[item] = 0.0 if size is None else size.width
            chains[connection.key].append(item)
    links = []
    for connection in graph.connections:
        if connection.key in chains:
            path = [f"node {connection.sender}", *chains[connection.key], f"node {connection.receiver}"]
            links += list(itertools.pairwise(path))
    columns = _fewest_crossings(columns, links)
    y = _heights(columns, links, heights)
    x, across, left = {}, {}, 0.0
    for items in columns:
        width = max([widths[item] for item in items], default=0.0)
        x |= {item: left + width / 2 for item in items}
        across |= dict.fromkeys(items, width)
        left += width + _GUTTER
    low = min(y[item] - heights[item] / 2 for item in y)
    high = max(y[item] + heights[item] / 2 for item in y)
    boxes = {n: Box(x[f"node {n}"], y[f"node {n}"] - low, *sizes[n]) for n in graph.index}
    labels, routes = {}, {}
    for connection in graph.connections:
        if connection.key not in chains:
            continue
        points = []
        forward = layer[connection.sender] < layer[connection.receiver]
        for item in chains[connection.key]:
            half = across[item] / 2 * (1 if forward else -1)  # level past all boxes of the column
            points += [(x[item] - half, y[item] - low), (x[item] + half, y[item] - low)]
            if widths[item]:
                labels[connection.key] = Box(x[item], y[item] - low, widths[item], heights[item])
        ends = [
            (box.x + side * box.width / 2, box.y)
            for box, side in (
                (boxes[connection.sender], 1 if forward else -1),
                (boxes[connection.receiver], -1 if forward else 1),
            )
        ]
        routes[connection.key] = np.array([ends[0], *points, ends[1]])
    _spread_ends(graph, boxes, routes)
    return Placement(boxes, labels, routes, layer, left - _GUTTER, high - low)


def _flow(graph: Graph) -> dict[str, list[str]]:
    """Successors by node name, without a cycle: feedback is turned round."""
    after: dict[str, list[str]] = {name: [] for name in graph.index}

    def leads(start: str, goal: str) -> bool:
        found, waiting = {start}, [start]
        while waiting:
            for successor in after[waiting.pop()]:
                if successor not in found:
                    found.add(successor)
                    waiting.append(successor)
        return goal in found

    for connection in sorted(graph.connections, key=lambda c: c.skip):
        sender, receiver = connection.sender, connection.receiver
        if sender == receiver:
            continue
        if connection.skip and leads(receiver, sender):
            sender, receiver = receiver, sender
        after[sender].append(receiver)
    return after


def _order(after: Mapping[str, Sequence[str]]) -> list[str]:
    waits = dict.fromkeys(after, 0)
    for successors in after.values():
        for successor in successors:
            waits[successor] += 1
    order = [name for name, count in waits.items() if count == 0]
    for name in order:  # grows while it is walked
        for successor in after[name]:
            waits[successor] -= 1
            if waits[successor] == 0:
                order.append(successor)
    return order


def _fewest_crossings(columns: list[list[str]], links: list[tuple[str, str]]) -> list[list[str]]:
    """Order each column by the mean place of what its items are linked to, back and forth."""
    near: dict[str, list[str]] = {item: [] for items in columns for item in items}
    for a, b in links:
        near[a].append(b)
        near[b].append(a)
    column_of = {item: c for c, items in enumerate(columns) for item in items}
    best, fewest = [list(items) for items in columns], _crossings(columns, links)
    now = [list(items) for items in columns]
    for sweep in range(_SWEEPS):
        forward = sweep % 2 == 0
        for c in range(1, len(now)) if forward else range(len(now) - 2, -1, -1):
            other = c - 1 if forward else c + 1
            rank = {item: place for place, item in enumerate(now[other])}
            own = {item: place for place, item in enumerate(now[c])}
            mean = {}
            for item in now[c]:
                places = [rank[n] for n in near[item] if column_of[n] == other]
                mean[item] = float(np.mean(places)) if places else own[item]
            now[c].sort(key=lambda item: (mean[item], own[item]))
        count = _crossings(now, links)
        if count < fewest:
            best, fewest = [list(items) for items in now], count
    return best


def _crossings(columns: list[list[str]], links: list[tuple[str, str]]) -> int:
    where = {item: (c, place) for c, items in enumerate(columns) for place, item in enumerate(items)}
    between: dict[int, list[tuple[int, int]]] = {}
    for a, b in links:
        (column, start), (_, end) = sorted((where[a], where[b]))
        between.setdefault(column, []).append((start, end))
    count = 0
    for pairs in between.values():
        ends = np.array(pairs)
        start, end = ends[:, 0], ends[:, 1]
        count += int(((start[:, None] < start) & (end[:, None] > end)).sum())
    return count


def _heights(
    columns: list[list[str]], links: list[tuple[str, str]], heights: Mapping[str, float]
) -> dict[str, float]:
    """Draw linked items to one height, as near as the least distances of a column allow.

    Each column is a least-squares fit under an order, which is isotonic regression.
    """
    near: dict[str, list[tuple[str, float]]] = {item: [] for items in columns for item in items}
    for a, b in links:
        # Where a connection only passes it should run straight; boxes follow their neighbours.
        pull = _STRAIGHT if a.startswith("passes") and b.startswith("passes") else 1.0
        near[a].append((b, pull))
        near[b].append((a, pull))

    def wanted(item: str) -> float:
        pulls = sum(pull for _, pull in near[item])
        return sum(pull * y[other] for other, pull in near[item]) / pulls if near[item] else y[item]

    y: dict[str, float] = {}
    least: list[np.ndarray] = []
    for items in columns:
        size = np.array([heights[item] for item in items])
        steps = (size[:-1] + size[1:]) / 2 + _GAP
        offset = np.concatenate([[0.0], np.cumsum(steps)])
        least.append(offset)
        y |= {item: offset[-1] / 2 - o for item, o in zip(items, offset, strict=True)}
    for sweep in range(_SWEEPS):
        order = range(len(columns)) if sweep % 2 == 0 else range(len(columns) - 1, -1, -1)
        for c in order:
            items = columns[c]
            goal = np.array([wanted(item) for item in items]) + least[c]
            fitted = isotonic_regression(goal, increasing=False).x - least[c]
            y |= dict(zip(items, fitted.tolist(), strict=True))
    return y


def _spread_ends(graph: Graph, boxes: Mapping[str, Box], routes: dict[str, np.ndarray]) -> None:
    """Let the connections of one side of a box begin and end at different heights, in the order they leave."""
    sides: dict[tuple[str, bool], list[tuple[float, str, int]]] = {}
    for connection in graph.connections:
        if connection.key in routes:
            route = routes[connection.key]
            for name, end, beside in ((connection.sender, 0, 1), (connection.receiver, -1, -2)):
                right = bool(route[end, 0] > boxes[name].x)
                sides.setdefault((name, right), []).append((float(route[beside, 1]), connection.key, end))
    for (name, _), leaving in sides.items():
        leaving.sort()
        reach = 0.62 * boxes[name].height
        for place, (_, key, end) in enumerate(leaving):
            share = (place + 1) / (len(leaving) + 1) - 0.5
            routes[key][end, 1] = boxes[name].y + reach * share
