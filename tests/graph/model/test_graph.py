"""A graph that does not fit together says what is wrong with it."""

import pytest
import torch

from deepkoco.graph import Connection, DelayError, Graph, GraphError, Node, Supervisor
from deepkoco.graph.delay import Lossy
from tests.graph.timing_reference import Accumulate


class Picky(Accumulate):
    """A node that reads exactly one input."""

    inputs = ("command",)


def agent() -> Node:
    return Supervisor("agent", 10, initial_action=torch.zeros(2))


def test_senders_come_before_their_receivers():
    nodes = [agent(), Accumulate("sensor", 10), Accumulate("world", 10)]
    connections = [
        Connection("world", "sensor"),
        Connection("sensor", "agent"),
        Connection("agent", "world", skip=True),
    ]
    graph = Graph(nodes, connections)
    assert [graph.nodes[n].name for n in graph.order] == ["world", "sensor", "agent"]


def test_a_cycle_is_named():
    nodes = [agent(), Accumulate("a", 10), Accumulate("b", 10), Accumulate("c", 10)]
    ring = [Connection("a", "b"), Connection("b", "c"), Connection("c", "a"), Connection("c", "agent")]
    with pytest.raises(GraphError, match=r"cycle .*: (a -> b -> c -> a|b -> c -> a -> b|c -> a -> b -> c)"):
        Graph(nodes, ring)
    with pytest.raises(GraphError, match=r"cycle .*: a -> a; set skip=True"):
        Graph(nodes, [Connection("a", "a")])


@pytest.mark.parametrize(
    ("nodes", "connections", "message"),
    [
        ([agent(), Accumulate("a", 10), Accumulate("a", 20)], [], '2 nodes are called "a"'),
        ([Accumulate("a", 10)], [], 'supervisor "agent" is no node; known: a'),
        ([agent()], [Connection("agent", "b")], '"agent->b": "b" is no node; known: agent'),
        ([agent(), Picky("p", 10)], [], 'input "command" of node "p" is not connected'),
        (
            [agent(), Picky("p", 10)],
            [Connection("agent", "p")],
            'node "p" has no input "agent"; it has command',
        ),
        (
            [agent(), Accumulate("a", 10)],
            [Connection("a", "agent"), Connection("a", "agent", window=2)],
            'input "agent.a" is connected twice',
        ),
        (
            [agent(), Supervisor("boss", 5, initial_action=torch.zeros(2))],
            [],
            'node "boss" is a Supervisor, but the supervisor is "agent"; a graph has one',
        ),
    ],
)
def test_what_does_not_fit_is_refused(nodes, connections, message):
    with pytest.raises(GraphError, match=message):
        Graph(nodes, connections)


def test_two_connections_of_a_pair_need_two_names():
    near, far = Connection("a", "agent"), Connection("a", "agent", 0.1, name="late")
    graph = Graph([agent(), Accumulate("a", 10)], [near, far])
    assert [c.key for c in graph.connections] == ["a->agent", "a->agent:late"]


def test_bad_settings_are_refused():
    with pytest.raises(GraphError, match='node "a": rate -1 Hz'):
        Accumulate("a", -1)
    with pytest.raises(GraphError, match='scheduling "often" is none of frequency, phase'):
        Accumulate("a", 1, scheduling="often")
    for rate in (float("nan"), 0, float("inf"), "fast"):
        with pytest.raises(GraphError, match=f'node "a": rate {rate} Hz is no'):
            Accumulate("a", rate)
    with pytest.raises(GraphError, match='node "a": phase nan s is no number >= 0'):
        Accumulate("a", 1, phase=float("nan"))
    with pytest.raises(GraphError, match='"a->b": window 0 is no whole number >= 1'):
        Connection("a", "b", window=0)
    with pytest.raises(GraphError, match='"a->b": window 2000 is more than the 1024 messages'):
        Connection("a", "b", window=2000)
    with pytest.raises(DelayError, match=r'node "a": .*nan s is no delay'):
        Accumulate("a", 1, float("nan"))
    with pytest.raises(DelayError, match=r'connection "a->b:late": .*-0.1 s is no delay'):
        Connection("a", "b", -0.1, name="late")
    with pytest.raises(DelayError, match='node "a": a computation cannot get lost'):
        Accumulate("a", 1, Lossy(0.1, 0.5))
    with pytest.raises(GraphError, match='jitter "none" is none of latest, buffer'):
        Connection("a", "b", jitter="none")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"correlations": [{"channels": ["a", "b"], "value": 0.5}]},
            '"b" is no node or connection; known: a',
        ),
        (
            {"correlations": [{"channels": ["a", "agent"], "value": 0.5}]},
            "rank correlation of a and agent: they belong to a and agent; .* of one publisher",
        ),
        (
            {"correlations": [{"channels": ["a", "a->agent"], "value": v} for v in (0.1, 0.2)]},
            'rank correlation: "a" is in two',
        ),
        (
            {"stalls": [{"rate": 1, "duration": 0.1, "channels": ["b"]}]},
            'stalls: "b" is no node or connection',
        ),
        ({"stalls": [{"rate": 1, "length": 0.1}]}, "stalls: .*unexpected keyword argument 'length'"),
    ],
)
def test_what_is_not_tied_together_is_refused(options, message):
    with pytest.raises(DelayError, match=message):
        Graph([Accumulate("a", 10), agent()], [Connection("a", "agent")], **options)
