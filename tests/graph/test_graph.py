"""A graph that does not fit together says what is wrong with it."""

import pytest
import torch
from timing_reference import Accumulate

from deepkoco.graph import Connection, Graph, GraphError, Node, Supervisor


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
    with pytest.raises(GraphError, match='"a->b": window 0 is less than 1'):
        Connection("a", "b", window=0)
    with pytest.raises(GraphError, match='jitter "none" is none of latest, buffer'):
        Connection("a", "b", jitter="none")
