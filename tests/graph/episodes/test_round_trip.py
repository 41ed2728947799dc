"""What is written comes back bit for bit, and runs again to the last bit."""

import json

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from deepkoco.graph import BatchedRuntime, Connection, Gaussian, Graph, Mixture, Supervisor, draw_timing
from deepkoco.graph.episodes.episode import Episode, Note, record_episodes, replay_episode
from deepkoco.graph.episodes.fitting import fit_delays
from deepkoco.graph.episodes.storage import (
    EpisodeFileError,
    RecordedNode,
    describe_graph,
    graph_from_description,
    read_episodes,
    write_episodes,
)
from tests.graph.timing_reference import graphs, policy

PARTS = ("t_start", "t_end", "outputs", "t_sent", "t_received", "windows")


def act(inputs):
    return policy({name: i.data for name, i in inputs.items()}, 1)


def recorded(graph, steps: int, batch: int = 2):
    timing = draw_timing(graph, np.random.default_rng(0), steps, batch, rows=batch)
    generator = torch.Generator().manual_seed(0)
    initial = {node.name: node.init({}, generator, batch) for node in graph.nodes}
    return record_episodes(BatchedRuntime(graph, timing), act, {}, generator, initial)[0], initial


def assert_equal(first: Episode, second: Episode) -> None:
    for part in PARTS:
        old, new = getattr(first, part), getattr(second, part)
        assert old.keys() == new.keys()
        for key, array in old.items():
            assert array.dtype == new[key].dtype, (part, key)
            assert array.shape == new[key].shape, (part, key)
            assert array.tobytes() == new[key].tobytes(), (part, key)
    assert first.notes == second.notes


@settings(max_examples=25, deadline=None)
@given(graph=graphs(), steps=st.integers(1, 5))
def test_recordings_come_back_and_replay_bit_for_bit(graph, steps, tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    episodes, initial = recorded(graph, steps)
    run = read_episodes(write_episodes(path, graph, episodes, {"seed": 0}))
    assert run.complete
    assert run.meta == {"seed": 0}
    for row, (episode, again) in enumerate(zip(episodes, run.episodes, strict=True)):
        assert_equal(episode, again)
        alone = {n: {k: v[row : row + 1] for k, v in s.items()} for n, s in initial.items()}
        assert_equal(episode, replay_episode(graph, again, {}, torch.Generator(), alone)[0])


DTYPES = st.sampled_from(["f2", "f4", "f8", ">f4", ">f8", "i1", "i4", "i8", "u1", "u8", "?", "c8", "c16"])


@st.composite
def outputs(draw):
    shape = draw(st.sampled_from([(), (1,), (3,), (2, 2), (0,), (40, 40)]))
    steps = draw(st.integers(1, 3))
    dtype = np.dtype(draw(DTYPES))
    if len(shape) == 2 and shape[0] > 2:
        raw = np.random.default_rng(draw(st.integers(0, 9))).integers(0, 2, (steps, *shape))
        return raw.astype(dtype)
    return draw(hnp.arrays(dtype, (steps, *shape)))


@settings(max_examples=150, deadline=None)
@given(output=outputs(), times=st.data())
def test_every_number_comes_back_bit_for_bit(output, times, tmp_path_factory):
    graph = Graph(
        [Supervisor("agent", 20, initial_action=torch.zeros(1))], [Connection("agent", "agent", skip=True)]
    )
    finite = st.floats(-1e9, 1e9)
    k = len(output)
    start, end, sent = (times.draw(hnp.arrays(np.float64, k, elements=finite)) for _ in range(3))
    received = times.draw(hnp.arrays(np.float64, k, elements=finite | st.just(np.inf)))
    windows = np.arange(-1, k - 1, dtype=np.int32)[:, None]
    key = "agent->agent"
    episode = Episode(
        {"agent": start}, {"agent": end}, {"agent": output}, {key: sent}, {key: received}, {key: windows}
    )
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    assert_equal(episode, read_episodes(write_episodes(path, graph, [episode])).episodes[0])


@settings(max_examples=30, deadline=None)
@given(graph=graphs())
def test_the_graph_comes_back_with_its_times(graph):
    again = graph_from_description(describe_graph(graph))
    assert describe_graph(again) == describe_graph(graph)
    assert again.phases == graph.phases
    assert again.order == graph.order
    assert [c.key for c in again.connections] == [c.key for c in graph.connections]


def test_a_known_delay_law_comes_back_as_itself_and_a_node_without_its_code():
    law = Mixture((Gaussian(0.01, 0.002), Gaussian(0.1, 0.01)), (0.9, 0.1))
    supervisor = Supervisor("agent", 20, initial_action=torch.zeros(1))
    graph = Graph([supervisor], [Connection("agent", "agent", law, window=3, skip=True, name="last")])
    again = graph_from_description(describe_graph(graph))
    assert again.connections == graph.connections
    with pytest.raises(
        ValueError, match="holds its times and outputs but not the code of its class Supervisor"
    ):
        again.node("agent").step({}, {}, {})


def test_what_couples_delays_comes_back():
    supervisor = Supervisor("agent", 20, initial_action=torch.zeros(1))
    sensor = RecordedNode("sensor", 20, kind="X")
    law = Gaussian(0.01, 0.002)
    graph = Graph(
        [sensor, supervisor],
        [Connection("sensor", "agent", law), Connection("sensor", "agent", law, name="again")],
        correlations=[{"channels": ("sensor->agent", "sensor->agent:again"), "value": 0.8}],
        stalls=[{"rate": 0.5, "duration": 0.1}],
    )
    again = graph_from_description(json.loads(json.dumps(describe_graph(graph))))
    assert again.correlations == graph.correlations
    assert again.stalls == graph.stalls


def test_a_delay_model_is_fitted_from_what_was_read(tmp_path):
    law = Gaussian(0.02, 0.004)
    sent = np.arange(500) / 10
    delay = law.sample(np.random.default_rng(0), (500,))
    graph = Graph(
        [RecordedNode("sensor", 10, kind="X"), Supervisor(rate=10, initial_action=torch.zeros(1))],
        [Connection("sensor", "agent")],
    )
    key = "sensor->agent"
    times = {"sensor": sent, "agent": sent}
    episode = Episode(times, times, {}, {key: sent}, {key: sent + delay}, {})
    read = read_episodes(write_episodes(tmp_path / "run.mcap", graph, [episode])).episodes[0]
    fitted = fit_delays(read)
    assert fitted.laws[key].mean == pytest.approx(0.02, rel=0.05)
    assert fitted.laws[key] == fit_delays(episode).laws[key]


def test_episodes_that_do_not_fit_the_graph_are_refused_and_leave_nothing(tmp_path):
    graph = Graph([Supervisor("agent", 20, initial_action=torch.zeros(1))], [])
    good = Episode(
        {"agent": np.zeros(2)}, {"agent": np.zeros(2)}, {}, {}, {}, {}, (Note(0.0, "info", "", "hm"),)
    )
    bad = Episode({"agent": np.zeros(2)}, {"agent": np.array([0.0, np.nan])}, {}, {}, {}, {})
    with pytest.raises(EpisodeFileError, match='episode 1: node "agent" has a time that is not finite'):
        write_episodes(tmp_path / "run.mcap", graph, [good, bad])
    assert not list(tmp_path.iterdir())
    assert_equal(good, read_episodes(write_episodes(tmp_path / "run.mcap", graph, [good])).episodes[0])
    with pytest.raises(EpisodeFileError, match="exists"):
        write_episodes(tmp_path / "run.mcap", graph, [good])
