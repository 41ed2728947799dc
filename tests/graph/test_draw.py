"""The pictures show every node, step and used message."""

import numpy as np
import torch
from matplotlib.figure import Figure
from timing_reference import Accumulate

from deepkoco.graph import Connection, Graph, Supervisor, draw_timing
from deepkoco.graph.draw import draw_graph, draw_timeline

GRAPH = Graph(
    [
        Accumulate("world", 20),
        Accumulate("sensor", 10, 0.02),
        Supervisor(rate=10, initial_action=torch.zeros(2)),
    ],
    [
        Connection("world", "sensor"),
        Connection("sensor", "agent", 0.03),
        Connection("agent", "world", skip=True, window=2),
    ],
)


def test_the_timeline_has_a_bar_a_step_and_an_arrow_a_message_used():
    timing = draw_timing(GRAPH, np.random.default_rng(0), 4, batch=1)
    axes = Figure().subplots()
    draw_timeline(axes, timing)
    assert [label.get_text() for label in axes.get_yticklabels()] == ["world", "sensor", "agent"]
    bars = [len(collection.get_paths()) for collection in axes.collections]
    assert bars == [timing.count(0, n) for n in range(3)]
    used = sum((timing.windows_of(e).max(axis=1) >= 0).sum() for e in range(3))
    assert len(axes.texts) == used


def test_the_graph_shows_rates_and_expected_delays():
    axes = Figure().subplots()
    draw_graph(axes, GRAPH)
    texts = [text.get_text() for text in axes.texts]
    assert texts == ["30 ms", "world\n20 Hz", "sensor\n10 Hz", "agent\n10 Hz"]
    assert [arrow.get_linestyle() for arrow in axes.patches] == ["-", "-", "--"]
