"""A setup holds what of a graph can change without its code, and a graph takes it from a file."""

from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.engines import OdeEngine, make_graph
from deepkoco.graph import (
    BatchedRuntime,
    Connection,
    Gaussian,
    Graph,
    GraphError,
    Node,
    Supervisor,
    draw_timing,
)
from deepkoco.graph.episodes.storage.description import describe_graph, graph_from_description
from deepkoco.graph.setup import (
    SetupError,
    apply_parameters,
    apply_setup,
    describe_setup,
    read_setup,
    write_setup,
)
from deepkoco.systems import make_system


class Plain(Node):
    """Sends what it hears."""

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1)

    def step(self, parameters, state, inputs):
        return state, next(iter(inputs.values())).data[:, -1]


class Filter(Plain):
    """Keeps a weight that it worked out from its rate."""

    def __init__(self, name, rate, delay=0.0):
        super().__init__(name, rate, delay)
        self.weight = 1.0 / rate


def graph(middle=Plain, **options):
    return Graph(
        [
            Plain("world", 100, 0.001),
            middle("filter", 50),
            Supervisor(rate=20, initial_action=torch.zeros(1)),
        ],
        [
            Connection("world", "filter", Gaussian(0.01, 0.002), window=3),
            Connection("filter", "agent", blocking=True),
            Connection("agent", "world", 0.03, skip=True),
        ],
        **options,
    )


DELAYS = st.one_of(
    st.floats(0.0, 0.5),
    st.builds(
        lambda loc, scale: {"law": "gaussian", "loc": loc, "scale": scale},
        st.floats(0, 0.1),
        st.floats(1e-9, 0.1),
    ),
    st.builds(
        lambda low, more: {"law": "uniform", "low": low, "high": low + more},
        st.floats(0, 0.1),
        st.floats(1e-9, 0.1),
    ),
)


@settings(deadline=None, max_examples=40)
@given(
    rates=st.lists(st.fractions(1, 1000, max_denominator=1000), min_size=2, max_size=2),
    delays=st.lists(DELAYS, min_size=3, max_size=3),
    window=st.integers(1, 9),
    jitter=st.sampled_from(["latest", "buffer"]),
)
def test_a_graph_that_takes_the_setup_of_another_has_its_timing(
    tmp_path_factory, rates, delays, window, jitter
):
    agent = Supervisor(rate=20, initial_action=torch.zeros(1))
    other = Graph(
        [Plain("world", rates[0], delays[0]), Plain("filter", rates[1]), agent],
        [
            Connection("world", "filter", delays[1], window=window, jitter=jitter),
            Connection("filter", "agent", delays[2], fifo=False),
            Connection("agent", "world", skip=True),
        ],
        stalls=[{"rate": 0.1, "duration": 0.01}],
    )  # fmt: skip
    path = write_setup(tmp_path_factory.mktemp("setup") / "setup.yaml", other)
    taken = apply_setup(graph(), read_setup(path))
    assert [node.rate for node in taken.nodes] == [node.rate for node in other.nodes]
    assert taken.connections == other.connections
    first, second = (draw_timing(each, np.random.default_rng(0), 5, batch=1) for each in (other, taken))
    for name in ("t_start", "t_end", "t_received", "windows"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


def test_what_a_setup_does_not_name_stays_and_the_graph_that_is_given_does():
    own = graph()
    changed = apply_setup(
        own, {"nodes": {"world": {"rate": 200}}, "connections": {"filter->agent": {"delay": 0.04}}}
    )
    assert (changed.node("world").rate, own.node("world").rate) == (200, 100)
    assert changed.node("world").delay == own.node("world").delay
    assert changed.connections[1].law.mean == 0.04
    assert changed.connections[1].blocking
    assert changed.connections[0] == own.connections[0]
    assert changed.node("filter") is not own.node("filter")


def test_a_recording_has_the_setup_of_its_graph():
    own = graph(correlations=[{"channels": ["world", "world->filter"], "value": 0.5}])
    recorded = graph_from_description(describe_graph(own))
    assert describe_setup(recorded) == describe_setup(own)


def test_a_rate_may_be_written_as_a_fraction():
    assert apply_setup(graph(), {"nodes": {"world": {"rate": "100/3"}}}).node("world").rate == Fraction(
        100, 3
    )


@pytest.mark.parametrize("changed", ["filter", "world"])
def test_a_node_that_may_have_worked_out_something_keeps_its_rate_and_those_of_its_senders(changed):
    with pytest.raises(
        SetupError, match=r'"filter": its class Filter may have worked out .* free_rate = True'
    ):
        apply_setup(graph(Filter), {"nodes": {changed: {"rate": 10}}})
    same = apply_setup(graph(Filter), {"nodes": {"filter": {"rate": 50, "delay": 0.002}}})
    assert same.node("filter").delay.mean == 0.002


def test_the_world_of_an_engine_runs_at_its_new_rate_as_if_it_was_made_with_it():
    made = make_graph("rod_pendulum", OdeEngine(world_rate=200.0), control_rate=20)
    slower = make_graph("rod_pendulum", OdeEngine(world_rate=100.0), control_rate=20)
    taken = apply_setup(slower, {"nodes": {"world": {"rate": 200}, "sensor": {"rate": 200}}})
    assert taken.connections == made.connections
    seen = []
    for each in (made, taken):
        runtime = BatchedRuntime(each, draw_timing(each, np.random.default_rng(0), 10, batch=1))
        start = make_system("rod_pendulum").default_parameters() | {
            "start": torch.tensor([[3.0, 0.0]], dtype=torch.float64)
        }
        state, _ = runtime.reset({"world": start, "sensor": start}, torch.Generator().manual_seed(0))
        for _ in range(5):
            state, inputs = runtime.step(state, torch.ones(1, 1, dtype=torch.float64))
        seen.append(inputs["sensor"].data)
    assert torch.equal(*seen)


def test_windows_grow_with_what_the_receiver_needs():
    law = {"law": "uniform", "low": 0.0, "high": 0.05}
    own = make_graph("rod_pendulum", control_rate=20, actuation_delay=law)
    window, key = own.connections[-1].window, own.connections[-1].key
    faster = {"nodes": {"agent": {"rate": 200}}}
    grown = apply_setup(own, faster).connections[-1].window
    assert grown == make_graph("rod_pendulum", control_rate=200, actuation_delay=law).connections[-1].window
    assert grown > window
    with pytest.raises(SetupError, match=f"window: {window} messages are too few, world needs {grown}"):
        apply_setup(own, faster | {"connections": {key: {"window": window}}})
    narrow = Graph(own.nodes, [*own.connections[:-1], Connection("agent", "world", law, skip=True)])
    assert apply_setup(narrow, describe_setup(narrow)).connections[-1].window == 1


@pytest.mark.parametrize(
    ("setup", "says"),
    [
        ({"node": {}}, 'there is no "node"; did you mean nodes'),
        ({"nodes": {"wrld": {"rate": 1}}}, 'nodes: there is no "wrld"; did you mean world'),
        ({"nodes": {"world": {"rat": 1}}}, 'nodes: world: there is no "rat"; did you mean rate'),
        ({"nodes": {"world": {"rate": "fast"}}}, "nodes: world: rate: 'fast' is no number"),
        ({"nodes": {"world": {"rate": 0}}}, 'node "world": rate 0 Hz is no positive number'),
        ({"nodes": {"world": {"phase": -1}}}, "nodes: world: phase: -1 s is below 0"),
        ({"nodes": {"world": {"scheduling": "both"}}}, "scheduling: it is one of frequency, phase"),
        (
            {"nodes": {"world": {"delay": {"law": "lossy", "delay": 0.1, "probability": 0.1}}}},
            "cannot get lost",
        ),
        ({"nodes": {"world": {"delay": {"law": "gausian"}}}}, 'delay law "gausian" is not known'),
        ({"connections": {"agent->world": {"skip": "yes"}}}, r"skip: 'yes' is no yes or no \(true, false\)"),
        ({"connections": {"agent->world": {"skip": False}}}, "cycle without a skipped connection"),
        ({"connections": {"world->filter": {"window": 0}}}, "window 0 is no whole number"),
        ({"nodes": {"world": {"rate": 10**400}}}, "is no number"),
        ({"nodes": {"world": {"delay": True}}}, "True is no number of seconds"),
        ({"nodes": {"world": {"delay": {"law": ["a"]}}}}, "is not known"),
        ({"stalls": {"rate": 1}}, "stalls: .* is no list of descriptions"),
        ({"correlations": [{"channels": ["a", "b"], "value": 0.1}]}, '"a" is no node or connection'),
        ([1], "the setup: .* is no table"),
    ],
)
def test_a_wrong_entry_is_named_with_the_way_out(setup, says):
    with pytest.raises(SetupError, match=says):
        apply_setup(graph(), setup)


def test_parameters_come_from_the_setup_in_their_own_type_and_shape():
    own = {"world": {"mass": torch.tensor(1.0), "start": torch.zeros(2, 2, dtype=torch.float64), "count": 3}}
    taken = apply_parameters(
        own, {"parameters": {"world": {"mass": 2, "start": [[1, 2], [3, 4]], "count": 4}}}
    )
    assert taken["world"]["mass"].dtype == torch.float32
    assert taken["world"]["mass"] == 2.0
    assert taken["world"]["start"].tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert taken["world"]["count"] == 4
    assert own["world"]["mass"] == 1.0
    assert apply_parameters(own, {"parameters": {"world": {"start": 5}}})["world"]["start"].eq(5.0).all()
    for wrong, says in (({"mas": 1}, 'no "mas"; did you mean mass'), ({"start": [1, 2]}, r"it has the shape \(2, 2\)"),
                        ({"mass": "heavy"}, "'heavy' is no number")):  # fmt: skip
        with pytest.raises(SetupError, match=says):
            apply_parameters(own, {"parameters": {"world": wrong}})


def test_a_whole_number_may_become_a_fraction_where_its_type_can_hold_it():
    own = {
        "world": {"mass": 1, "start": [1, 2], "count": torch.tensor(3), "on": True, "size": np.float64(2.0)}
    }

    def taken(**values):
        return apply_parameters(own, {"parameters": {"world": values}})["world"]

    assert taken(mass=1.3)["mass"] == 1.3
    assert taken(start=[1.5, 2.5])["start"].tolist() == [1.5, 2.5]
    assert float(taken(size=3)["size"]) == 3.0
    assert taken(count=4)["count"].item() == 4
    for wrong in ({"count": 3.7}, {"on": 0.5}):
        with pytest.raises(SetupError, match="does not fit its type"):
            taken(**wrong)
    for wrong in ([[1], [2, 3]], [10**400, 1]):
        with pytest.raises(SetupError, match="is no array of numbers"):
            taken(start=wrong)


def test_a_class_below_one_whose_rate_is_free_says_so_itself():
    class Free(Filter):
        free_rate = True

    class Below(Free):
        def __init__(self, name, rate):
            super().__init__(name, rate)
            self.square = self.weight**2

    assert Free("free", 50).at_rate(10).rate == 10
    with pytest.raises(GraphError, match="class Below may have worked out"):
        Below("below", 50).at_rate(10)


def test_weights_of_a_network_are_no_part_of_a_setup():
    described = describe_setup(graph(), {"filter": {"weights": torch.zeros(65), "gain": torch.tensor(0.5)}})
    assert described["parameters"] == {"filter": {"gain": 0.5}}


def test_a_file_is_not_overwritten_and_its_name_stands_in_the_error(tmp_path):
    path = write_setup(tmp_path / "setup.yaml", graph())
    with pytest.raises(SetupError, match="exists"):
        write_setup(path, graph())
    path.write_text("nodes: {world: {rte: 3}}")
    with pytest.raises(SetupError, match=r"setup\.yaml: nodes: world: there is no"):
        read_setup(path)
    path.write_text("")
    assert read_setup(path) == {}
