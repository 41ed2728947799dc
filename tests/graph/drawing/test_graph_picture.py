"""The picture of a graph shows every node and connection, and nothing lies on anything else."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from deepkoco.graph import Connection, Gaussian, Graph, Mixture, Supervisor
from deepkoco.graph.drawing import DrawingError, draw_graph
from deepkoco.graph.drawing.layers import Size, assign_layers, place
from deepkoco.graph.drawing.words import delay_words
from deepkoco.graph.episodes.storage import RecordedNode


def node(name, rate=100, delay=0.0, **options):
    return RecordedNode(name, rate, kind="X", delay=delay, **options)


AGENT = Supervisor(rate=20, initial_action=torch.zeros(1))
LOOP = Graph(
    [node("world"), node("camera", 30, Gaussian(0.02, 0.005), scheduling="phase"), AGENT],
    [
        Connection("world", "camera"),
        Connection("camera", "agent", 0.03, window=2, blocking=True),
        Connection("agent", "world", 0.005, skip=True),
        Connection("world", "world", skip=True, name="own"),
    ],
)


@st.composite
def any_graphs(draw):
    count = draw(st.integers(1, 19))
    names = [f"node_{i}" for i in range(count)] + ["agent"]
    pairs = draw(
        st.lists(st.tuples(st.sampled_from(range(count + 1)), st.sampled_from(range(count + 1))), max_size=30)
    )
    ends = dict.fromkeys((names[a], names[b]) for a, b in pairs)
    connections = [
        Connection(a, b, draw(st.sampled_from([0.0, 0.01])), skip=names.index(a) >= names.index(b))
        for a, b in ends
    ]
    return Graph([*(node(name) for name in names[:-1]), AGENT], connections)


@settings(max_examples=60, deadline=None)
@given(graph=any_graphs())
def test_boxes_labels_and_lines_keep_apart_in_any_graph(graph):
    sizes = {name: Size(1.0, 0.5) for name in graph.index}
    labelled = {c.key: Size(0.6, 0.15) for c in graph.connections if c.law.mean > 0}
    placed = place(graph, sizes, labelled)
    between = [c for c in graph.connections if c.sender != c.receiver]
    assert placed.boxes.keys() == set(graph.index)
    assert placed.labels.keys() == {c.key for c in between} & labelled.keys()
    things = [*placed.boxes.values(), *placed.labels.values()]
    for a, b in itertools.combinations(things, 2):
        assert abs(a.x - b.x) >= (a.width + b.width) / 2 or abs(a.y - b.y) >= (a.height + b.height) / 2
    for c in between:
        route = placed.routes[c.key]
        for name, box in placed.boxes.items():
            inside = (abs(route[:, 0] - box.x) < box.width / 2 - 1e-9) & (
                abs(route[:, 1] - box.y) < box.height / 2 - 1e-9
            )
            assert not inside.any(), (c.key, name)
        # Level stretches lie in a column: none of them runs through a box of that column.
        for (x0, y0), (x1, y1) in itertools.pairwise(route):
            if y0 == y1:
                for box in placed.boxes.values():
                    beside = max(x0, x1) <= box.x - box.width / 2 or min(x0, x1) >= box.x + box.width / 2
                    assert beside or abs(y0 - box.y) > box.height / 2 or y0 in (route[0, 1], route[-1, 1])


@settings(max_examples=60, deadline=None)
@given(graph=any_graphs())
def test_data_flows_from_left_to_right_except_where_it_feeds_back(graph):
    layer = assign_layers(graph)
    for c in graph.connections:
        if not c.skip:
            assert layer[c.sender] < layer[c.receiver]
        elif c.sender != c.receiver:
            assert layer[c.sender] != layer[c.receiver]


def test_every_node_and_connection_is_drawn_with_rate_and_delay():
    picture = draw_graph(LOOP)
    axes = picture.figure.axes[0]
    boxes = {p.get_label(): p for p in axes.patches if isinstance(p, FancyBboxPatch)}
    arrows = {p.get_label(): p for p in axes.patches if isinstance(p, FancyArrowPatch)}
    assert set(boxes) == {"world", "camera", "agent"}
    assert set(arrows) == {"world->camera", "camera->agent", "agent->world"}
    assert arrows["agent->world"].get_linestyle() != "-"
    assert arrows["camera->agent"].get_linewidth() > arrows["world->camera"].get_linewidth()
    assert boxes["agent"].get_linewidth() > boxes["world"].get_linewidth()
    texts = [text.get_text() for text in axes.texts]
    for text in ("100 Hz", "30 Hz, catches up", "20 (12–28) ms", "30 ms\nwindow 2", "5 ms"):
        assert text in texts
    assert "hears itself “own”" in texts


def test_arrows_point_from_sender_to_receiver():
    picture = draw_graph(LOOP)
    axes = picture.figure.axes[0]
    boxes = {p.get_label(): p.get_window_extent() for p in axes.patches if isinstance(p, FancyBboxPatch)}
    for arrow in (p for p in axes.patches if isinstance(p, FancyArrowPatch)):
        ends = axes.transData.transform(arrow.get_path().vertices)
        sender, receiver = str(arrow.get_label()).split("->")
        path = axes.transData.transform(arrow._path_original.vertices)
        assert boxes[sender].padded(1).contains(*path[0])
        assert boxes[receiver].padded(1).contains(*path[-1])
        assert np.isfinite(ends).all()


def test_no_text_leaves_its_box():
    picture = draw_graph(LOOP)
    axes = picture.figure.axes[0]
    boxes = [p.get_window_extent() for p in axes.patches if isinstance(p, FancyBboxPatch)]
    for text in axes.texts:
        if text.get_bbox_patch() is not None:
            continue  # a label of a connection
        extent = text.get_window_extent()
        assert any(
            box.x0 <= extent.x0
            and extent.x1 <= box.x1
            and box.y0 - 2 <= extent.y0
            and extent.y1 <= box.y1 + 2
            for box in boxes
        ), text.get_text()


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (Gaussian(0.0, 0.0), ""),
        (Gaussian(0.0125, 0.0), "12.5 ms"),
        (Mixture((Gaussian(0.01, 0.0), Gaussian(0.1, 0.0)), (0.5, 0.5)), "55 (10–100) ms"),
        (Gaussian(0.0002, 0.00002), "0.2 (0.17–0.23) ms"),
    ],
)
def test_delays_are_told_with_their_spread(law, words):
    assert delay_words(law) == words


def test_pictures_are_saved_with_their_table_and_never_over_another(tmp_path):
    picture = draw_graph(LOOP)
    png, csv = picture.save(tmp_path)
    assert png.read_bytes().startswith(b"\x89PNG")
    assert csv.read_text().splitlines()[1].startswith("node,world,100.0,")
    with pytest.raises(DrawingError, match="exists"):
        picture.save(tmp_path)
    again, _ = draw_graph(LOOP).save(tmp_path, "again")
    assert again.read_bytes() == png.read_bytes()
