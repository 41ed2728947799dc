"""The synchronisation protocol counts exactly, and the plan made of it is that of the exact timing."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from live_nodes import Timed, assert_same, run

from deepkoco.graph import (
    Connection,
    Deterministic,
    Gaussian,
    Graph,
    Supervisor,
    draw_timing,
    replay_episode,
)
from deepkoco.graph.live import ProtocolError, ProtocolPlan, SimulatedRuntime
from deepkoco.graph.live.protocol import cyclic_count, expected_count, published_cyclic_count
from tests.graph.timing_reference import Accumulate

RATES = (1, 2, 3, 4, 5, 6, 7, 9, 10, 12, 15, 20, 30, 50, 100)
LAGS = (0, 1 / 7, 1 / 3, 0.1, 1 / 30, 1 / 60, 0.05, 0.02, 2 / 9, 1 / 90, 0.123)
CASES = [
    (Fraction(f), Fraction(n), Fraction(lag).limit_denominator(1000))
    for f, n, lag in itertools.product(RATES, RATES, LAGS)
]


def usable(i, k, f_i, f_n, tau, cyclic) -> bool:
    """The rule as it is written down."""
    there = i / f_i + tau <= k / f_n or i == k == 0
    return there and (not cyclic or i / f_i < k / f_n)


def oracle(ticks, f_i, f_n, tau, cyclic) -> list[int]:
    """Count message by message; what was usable once stays so."""
    count, counts = 0, []
    for k in range(ticks):
        while usable(count, k, f_i, f_n, tau, cyclic):
            count += 1
        counts.append(count)
    return counts


def test_a_slow_receiver_counts_by_hand():
    # 100 Hz into 50 Hz, 15 ms under way: at 0, 20, 40 ms messages up to 0 (always), 0 (5 ms), 2 (25 ms).
    counts = [expected_count(k, Fraction(100), Fraction(50), Fraction(15, 1000)) for k in range(3)]
    assert counts == [1, 1, 3]
    # On a cyclic connection nothing is there at first, and with no delay the message of the instant is not.
    counts = [expected_count(k, Fraction(100), Fraction(50), Fraction(0), cyclic=True) for k in range(3)]
    assert counts == [0, 2, 4]


@pytest.mark.parametrize("cyclic", [False, True])
def test_counts_equal_the_rule_in_2475_rate_and_delay_combinations(cyclic):
    assert len(CASES) == 2475
    for f_i, f_n, tau in CASES:
        counted = [expected_count(k, f_i, f_n, tau, cyclic) for k in range(8)]
        assert counted == oracle(8, f_i, f_n, tau, cyclic)


def test_the_published_count_of_cyclic_connections_is_one_message_late_or_early_in_most_combinations():
    late = early = 0
    for f_i, f_n, tau in CASES:
        wrong = {
            published_cyclic_count(k, f_i, f_n, tau) - expected_count(k, f_i, f_n, tau, True)
            for k in range(20)
        }
        assert wrong in ({0}, {0, -1}, {-1}, {0, 1})
        late += -1 in wrong
        early += 1 in wrong
    assert (late, early) == (1444, 179)


def test_the_plan_of_the_published_count_waits_for_other_messages():
    # 4 Hz into 3 Hz, 1/3 s under way: message 2 comes at 0.83 s, and their program awaits it at tick 2, 0.67 s.
    agent = Supervisor("agent", 3, initial_action=torch.zeros(2), phase=0)
    connection = Connection("n", "agent", Deterministic(1 / 3), skip=True)
    graph = Graph([Accumulate("n", 4), agent], [connection])
    seen = [
        [ProtocolPlan(graph, **own).of("agent").step(k).windows[0].seq[-1] for k in range(4)]
        for own in ({}, {"count": published_cyclic_count})
    ]
    assert seen == [[-1, 0, 1, 2], [-1, 0, 2, 3]]


rates = st.sampled_from([Fraction(n) for n in (7, 10, 20, 30, 50, 60, 100)] + [Fraction(25, 3)])
delays = st.integers(0, 60).map(lambda n: Fraction(5 * n, 1000))


@settings(deadline=None, max_examples=60)
@given(rates, rates, delays, st.booleans(), st.integers(0, 40))
def test_counts_never_fall_and_never_pass_what_has_been_sent(f_i, f_n, tau, cyclic, tick):
    count = expected_count(tick, f_i, f_n, tau, cyclic)
    assert expected_count(tick - 1, f_i, f_n, tau, cyclic) <= count <= tick * f_i / f_n + 1


@settings(deadline=None, max_examples=60)
@given(rates, rates, delays, st.integers(1, 3), st.booleans())
def test_windows_are_those_of_the_exact_timing_but_for_the_first_message(f_i, f_n, tau, window, cyclic):
    """The protocol waits for message 0 at tick 0; a message that comes at the instant of a tick is in time."""
    agent = Supervisor("agent", f_n, initial_action=torch.zeros(2), phase=0)
    connection = Connection("n", "agent", float(tau), window=window, skip=cyclic)
    graph = Graph([Accumulate("n", f_i), agent], [connection])
    drawn = draw_timing(graph, np.random.default_rng(0), 12, 1).windows_of(0)
    part = ProtocolPlan(graph).of("agent")
    for k in range(13):
        (seen,) = part.step(k).windows
        arrived = [i for i in range(int(k / f_n * f_i) + 1) if i / f_i + tau <= k / f_n]
        tie = cyclic and any(i / f_i + tau == k / f_n and tau > 0 for i in arrived)
        first = not cyclic and not arrived
        if not tie and not first:
            assert list(seen.seq) == drawn[k].tolist()
        elif first:
            assert seen.seq[-1] == 0


@settings(deadline=None, max_examples=40)
@given(
    speeds=st.tuples(rates, rates, rates),
    lags=st.tuples(delays, delays, delays),
    window=st.integers(1, 3),
    count=st.sampled_from([cyclic_count, published_cyclic_count]),
)
def test_an_episode_by_the_protocol_replays_bitwise(speeds, lags, window, count):
    agent = Supervisor("agent", speeds[2], initial_action=torch.zeros(2, dtype=torch.float64), phase=0.3)
    graph = Graph(
        [Timed("world", speeds[0]), Timed("sensor", speeds[1]), agent],
        [
            Connection("world", "sensor", float(lags[0]), window=window),
            Connection("sensor", "agent", float(lags[1])),
            Connection("agent", "world", float(lags[2]), window=window, skip=True),
        ],
    )
    runtime = SimulatedRuntime(graph)
    runtime._protocol = ProtocolPlan(graph, count)
    episode = run(runtime, 6)
    again, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(0))
    assert_same(episode, again)


@settings(deadline=None, max_examples=60)
@given(rates, rates, delays, st.integers(1, 3))
def test_the_oldest_messages_are_taken_first_and_none_is_passed_over(f_i, f_n, tau, window):
    agent = Supervisor("agent", f_n, initial_action=torch.zeros(2))
    graph = Graph([Accumulate("n", f_i), agent], [Connection("n", "agent", float(tau), window=window)])
    part = ProtocolPlan(graph).of("agent")
    taken = 0
    for k in range(10):
        (seen,) = part.step(k).windows
        more = expected_count(k, f_i, f_n, tau) - taken
        queue = list(range(-window, taken)) + list(range(taken, taken + more))
        assert list(seen.seq) == queue[-window:]
        taken += more


@pytest.mark.parametrize(
    ("node", "connection", "message"),
    [
        ({"delay": Gaussian(0.01, 0.01)}, {}, 'node "n": random'),
        ({"delay": 0.2}, {}, 'node "n": computes 0.2 s, longer than its period 0.1 s'),
        ({}, {"delay": Gaussian(0.01, 0.01)}, 'connection "n->agent": random'),
        ({}, {"blocking": True}, 'connection "n->agent": blocks'),
    ],
)
def test_what_counting_cannot_tell_is_refused_by_name(node, connection, message):
    agent = Supervisor("agent", 10, initial_action=torch.zeros(2))
    graph = Graph([Accumulate("n", 10, **node), agent], [Connection("n", "agent", **connection)])
    with pytest.raises(ProtocolError, match=message):
        ProtocolPlan(graph)
