"""The timeline shows every step and message of an episode worked out by hand."""

import numpy as np
import pytest
import torch
from matplotlib.collections import LineCollection, PolyCollection

from deepkoco.graph import Connection, Episode, Graph, Supervisor, draw_timing
from deepkoco.graph.drawing import DrawingError, draw_timeline
from deepkoco.graph.episodes.episode import episode_of_timing
from deepkoco.graph.episodes.storage import RecordedNode
from deepkoco.graph.episodes.tables import messages_table, steps_table

GRAPH = Graph(
    [RecordedNode("sensor", 10, kind="X"), Supervisor(rate=5, initial_action=torch.zeros(1))],
    [Connection("sensor", "agent", window=2)],
)
# The third step of the sensor takes 150 ms of 100 ms, so the fourth is 100 ms late; message 1 is lost, message 3
# comes too late for anyone.
EPISODE = Episode(
    t_start={"sensor": np.array([0.0, 0.1, 0.2, 0.4]), "agent": np.array([0.05, 0.25, 0.45])},
    t_end={"sensor": np.array([0.01, 0.11, 0.35, 0.41]), "agent": np.array([0.05, 0.25, 0.45])},
    outputs={},
    t_sent={"sensor->agent": np.array([0.01, 0.11, 0.35, 0.41])},
    t_received={"sensor->agent": np.array([0.03, np.inf, 0.40, 0.46])},
    windows={"sensor->agent": np.array([[-1, 0], [-1, 0], [0, 2]])},
)


def test_overruns_and_late_steps_are_told():
    steps = steps_table(GRAPH, EPISODE).set_index(["node", "seq"])
    assert steps.index[steps.overrun].tolist() == [("sensor", 2)]
    assert steps.index[steps.late_s > 0].tolist() == [("sensor", 3)]
    assert steps.late_s["sensor", 3] == pytest.approx(0.1)


def test_messages_are_told_with_their_first_use():
    messages = messages_table(GRAPH, EPISODE)
    assert messages.used_by.tolist() == [0, -1, 2, -1]
    np.testing.assert_array_equal(messages.t_used_s, [0.05, np.nan, 0.45, np.nan])
    np.testing.assert_array_equal(messages.t_received_s, [0.03, np.nan, 0.40, 0.46])


def test_every_step_is_a_bar_and_every_message_a_line_to_where_it_is_used():
    picture = draw_timeline(GRAPH, EPISODE, 0.0, 0.5)
    axes = picture.figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["sensor", "agent"]
    bars = [c for c in axes.collections if isinstance(c, PolyCollection)]
    assert sorted(len(c.get_paths()) for c in bars) == [1, 3, 4]  # one late stretch, three and four steps
    lines = {c.get_label(): c.get_segments() for c in axes.collections if isinstance(c, LineCollection)}
    flights = [(line[0, 0], line[1, 0]) for line in lines["flights sensor->agent"]]
    assert flights == [(0.01, 0.03), (0.35, 0.40), (0.41, 0.46)]
    waits = [(line[0, 0], line[-1, 0]) for line in lines["waits sensor->agent"]]
    assert waits == [(0.03, 0.05), (0.40, 0.45)]
    crosses = [line for line in axes.lines if line.get_marker() == "x"]
    assert crosses[0].get_xdata().tolist() == [0.11]
    upright = [line.get_xdata()[0] for line in axes.lines if len(set(line.get_xdata())) == 1][:3]
    assert upright == [0.05, 0.25, 0.45]
    assert picture.table.kind.value_counts().to_dict() == {"step": 7, "message": 4}


def test_only_the_asked_part_is_shown():
    table = draw_timeline(GRAPH, EPISODE, 0.3, 0.42).table
    assert table[table.kind == "step"].seq.tolist() == [2, 3]
    with pytest.raises(DrawingError, match="nothing ran between 7 s and"):
        draw_timeline(GRAPH, EPISODE, 7.0, 8.0)
    with pytest.raises(DrawingError, match="is not after start"):
        draw_timeline(GRAPH, EPISODE, 1.0, 0.5)


def test_drawn_timings_are_shown_like_recorded_ones():
    timing = draw_timing(GRAPH, np.random.default_rng(0), 3, batch=1)
    picture = draw_timeline(GRAPH, episode_of_timing(GRAPH, timing), stop=1.0)
    assert (picture.table.kind == "step").sum() == sum(timing.count(0, n) for n in range(2))


def test_an_episode_in_which_no_message_arrived_is_drawn():
    graph = Graph(
        [RecordedNode("world", 100, kind="World"), Supervisor(rate=50, initial_action=torch.zeros(1))],
        [Connection("world", "agent"), Connection("agent", "world", skip=True)],
    )
    times = {name: np.arange(3) / 50 for name in ("world", "agent")}
    sent = {c.key: times[c.sender] for c in graph.connections}
    never = {key: np.full(3, np.inf) for key in sent}
    picture = draw_timeline(graph, Episode(times, times, {}, sent, never, {}))
    assert len(picture.table) > 0
