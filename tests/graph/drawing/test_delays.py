"""Histograms count every delay once, beside what the law expects."""

import numpy as np
import pytest
import torch

from deepkoco.graph import Connection, Episode, Gaussian, Graph, Supervisor
from deepkoco.graph.drawing import DrawingError, draw_delays
from deepkoco.graph.episodes.storage import RecordedNode
from deepkoco.graph.episodes.tables import measured_delays

LAW = Gaussian(0.02, 0.004)
GRAPH = Graph(
    [RecordedNode("sensor", 10, kind="X", delay=0.005), Supervisor(rate=5, initial_action=torch.zeros(1))],
    [Connection("sensor", "agent", LAW)],
)


def episode(delays: np.ndarray) -> Episode:
    start = np.arange(len(delays)) / 10
    acts = np.arange(3) / 5
    return Episode(
        {"sensor": start, "agent": acts},
        {"sensor": start + 0.005, "agent": acts},
        {},
        {"sensor->agent": start + 0.005},
        {"sensor->agent": start + 0.005 + delays},
        {},
    )


def test_delays_are_collected_over_episodes_and_the_open_step_is_left_out():
    found = measured_delays(GRAPH, [episode(np.array([0.01, np.inf])), episode(np.array([0.03]))])
    np.testing.assert_allclose(found["sensor"], 0.005)
    np.testing.assert_allclose(found["sensor->agent"], [0.01, np.inf, 0.03])
    assert len(found["agent"]) == 4


def test_measured_delays_of_a_law_lie_on_its_line():
    delays = LAW.sample(np.random.default_rng(0), (40_000,))
    table = draw_delays(GRAPH, [episode(delays)]).table.set_index("channel")
    drawn = table.loc["sensor->agent"]
    assert drawn.measured.sum() == pytest.approx(1.0)
    assert drawn.expected.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(drawn.measured, drawn.expected, atol=5 * np.sqrt(0.1 / 40_000))
    constant = table.loc["sensor"]
    assert constant.measured.max() == 1.0
    assert constant.expected[constant.measured == 1.0].tolist() == [1.0]


def test_bars_and_line_are_the_table_and_losses_are_told():
    delays = np.full(50, 0.02)
    delays[:5] = np.inf
    picture = draw_delays(GRAPH, [episode(delays)])
    axes = picture.figure.axes[1]
    measured, expected = axes.patches
    drawn = picture.table.set_index("channel").loc["sensor->agent"]
    np.testing.assert_allclose(measured.get_data().values, 100 * drawn.measured)
    np.testing.assert_allclose(expected.get_data().values, 100 * drawn.expected)
    np.testing.assert_allclose(
        measured.get_data().edges, 1000 * np.append(drawn.low_s, drawn.high_s.iloc[-1])
    )
    assert drawn.measured.sum() == pytest.approx(0.9)
    assert [text.get_text() for text in axes.texts] == ["5 lost"]


def test_a_graph_in_which_nothing_takes_time_says_so():
    graph = Graph([Supervisor(rate=5, initial_action=torch.zeros(1))], [])
    still = Episode({"agent": np.zeros(2)}, {"agent": np.zeros(2)}, {}, {}, {}, {})
    with pytest.raises(DrawingError, match="no delay to show"):
        draw_delays(graph, [still])
