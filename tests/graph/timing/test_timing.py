"""Rates and delays become exact times: by hand, against the oracle, and by what must always hold."""

import itertools
from fractions import Fraction
from random import Random

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deepkoco.graph import (
    Connection,
    Deterministic,
    Gaussian,
    Graph,
    Mixture,
    Supervisor,
    TimingError,
    draw_timing,
    extend_timing,
)
from deepkoco.graph.delay import Autoregressive, DelayError, Gamma, Lossy, RecordedDelays, Stalls
from deepkoco.graph.timing.computation_graph import concatenate
from deepkoco.graph.timing.kernel import LOST
from tests.graph.timing_reference import (
    NEVER,
    Accumulate,
    Listed,
    ListedStalls,
    graphs,
    random_graph,
    reference_timing,
)


def agent(rate=10, **options) -> Supervisor:
    return Supervisor("agent", rate, initial_action=torch.zeros(1), **options)


def timed(graph: Graph, steps: int, batch: int = 1, **options):
    return draw_timing(graph, np.random.default_rng(0), steps, batch, **options)


def seconds(timing, name: str, row: int = 0) -> list[float]:
    start, _ = timing.steps_of(timing.layout.names.index(name), row)
    return (start / timing.resolution).tolist()


def chain(connection: Connection, sender_delay=0.0, **receiver) -> Graph:
    return Graph([Accumulate("n0", 10, sender_delay), agent(**receiver)], [connection])


def test_the_phase_is_the_expected_age_of_the_slowest_input():
    nodes = [Accumulate("a", 10, 0.01), Accumulate("b", 10, Gaussian(0.02, 0.0)), agent()]
    connections = [
        Connection("a", "b", 0.005),
        Connection("b", "agent", 0.03),
        Connection("a", "agent", 0.001),
        Connection("agent", "a", 0.5, skip=True),
    ]
    # a: 0; b: 0.01 + 0.005; agent: 0.015 + 0.02 + 0.03 by way of b.
    graph = Graph(nodes, connections)
    assert graph.phases == (0, Fraction(15, 1000), Fraction(65, 1000))
    assert seconds(timed(graph, 2), "agent") == [0.065, 0.165, 0.265]


def test_a_message_counts_from_the_instant_it_arrives_or_skipped_just_after():
    timing = timed(chain(Connection("n0", "agent"), phase=0), 3)
    assert timing.windows_of(0).tolist() == [[0], [1], [2], [3]]
    timing = timed(chain(Connection("n0", "agent", skip=True), phase=0), 3)
    assert timing.windows_of(0).tolist() == [[-1], [0], [1], [2]]


def test_the_window_fills_up_from_the_initial_output():
    timing = timed(chain(Connection("n0", "agent", 0.1, window=3), phase=0), 4)
    # The message of step i arrives at (i + 1) / 10, the very instant of tick i + 1.
    expected = [[-3, -2, -1], [-2, -1, 0], [-1, 0, 1], [0, 1, 2], [1, 2, 3]]
    assert timing.windows_of(0).tolist() == expected


def test_blocking_waits_and_leaves_later_messages_in_the_queue():
    # Messages of n0 (10 Hz) take 30, 130, 30 ms; the agent's ticks are at 0, 0.1, 0.2, 0.3 s.
    graph = chain(Connection("n0", "agent", Listed((30, 130, 30, 30)), blocking=True, window=2), phase=0)
    timing = timed(graph, 3)
    assert seconds(timing, "agent") == [0.03, 0.23, 0.23, 0.33]
    assert timing.windows_of(0)[:, -1].tolist() == [0, 1, 2, 3]


def test_waiting_does_not_shift_later_ticks_but_an_own_overrun_does():
    graph = Graph([Accumulate("n0", 10), agent(delay=Listed((0, 150, 0, 0, 0)))], [Connection("n0", "agent")])
    # Step 1 takes 150 ms of a period of 100: every later tick comes 50 ms later.
    expected = [0.0, 0.1, 0.25, 0.35, 0.45]
    np.testing.assert_allclose(np.subtract(seconds(timed(graph, 4), "agent"), 0), expected, rtol=1e-15)
    graph = Graph(
        [Accumulate("n0", 10), agent(delay=Listed((0, 150, 0, 0, 0)), scheduling="phase")],
        [Connection("n0", "agent")],
    )
    np.testing.assert_allclose(seconds(timed(graph, 4), "agent"), [0.0, 0.1, 0.25, 0.3, 0.4], rtol=1e-15)


def test_advance_starts_when_its_messages_are_there():
    connection = Connection("n0", "agent", Listed((10,)), blocking=True)
    graph = chain(connection, phase=0.05, advance=True)
    assert seconds(timed(graph, 2), "agent") == [0.01, 0.11, 0.21]
    assert seconds(timed(chain(connection, phase=0.05), 2), "agent") == [0.05, 0.15, 0.25]


def test_messages_do_not_overtake_unless_asked():
    delays = Listed((150, 10, 10, 10, 10))
    timing = timed(chain(Connection("n0", "agent", delays), phase=0.01), 3)
    assert (timing.messages_of(0)[1] / timing.resolution)[:3].tolist() == [0.15, 0.15, 0.21]
    assert timing.windows_of(0)[:, 0].tolist() == [-1, -1, 2, 3]
    timing = timed(chain(Connection("n0", "agent", delays, fifo=False, window=2), phase=0.01), 3)
    assert (timing.messages_of(0)[1] / timing.resolution)[:3].tolist() == [0.15, 0.11, 0.21]
    # At 0.11 s message 1 has overtaken message 0, which arrives at 0.15 s and message 2 at 0.21 s.
    assert timing.windows_of(0).tolist() == [[-2, -1], [-1, 1], [0, 2], [2, 3]]


def test_the_jitter_buffer_holds_early_messages_back():
    # Expected age 50 ms: message 1, there after 0 ms, is not used before 0.15 s.
    connection = Connection("n0", "agent", Listed((100, 0)), jitter="buffer")
    timing = timed(chain(connection, phase=0.02, rate=20), 5)
    # Ticks 0.02, 0.07, 0.12, 0.17, 0.22; message 0 arrives at 0.1, message 1 at 0.1 (nominal 0.15).
    assert timing.windows_of(0)[:, 0].tolist() == [-1, -1, 0, 1, 1, 1]


def test_the_control_loop_reads_now_and_acts_on_the_next_tick():
    graph = Graph(
        [Accumulate("world", 100), Accumulate("sensor", 20), agent(20), Accumulate("actuator", 20)],
        [
            Connection("world", "sensor"),
            Connection("sensor", "agent"),
            Connection("agent", "actuator"),
            Connection("actuator", "world", skip=True),
        ],
    )
    timing = timed(graph, 3, batch=5)
    assert timing.batch == 5
    assert len(timing.t_start) == 1
    assert timing.windows_of(0)[:, 0].tolist() == [0, 5, 10, 15]
    assert timing.windows_of(1)[:, 0].tolist() == [0, 1, 2, 3]
    assert timing.windows_of(2)[:, 0].tolist() == [0, 1, 2]
    assert timing.windows_of(3)[:12, 0].tolist() == [-1, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2]


RATES = (1, 2, 3, 4, 5, 6, 7, 9, 10, 12, 15, 20, 30, 50, 100)
LAGS = (0, 1 / 7, 1 / 3, 0.1, 1 / 30, 1 / 60, 0.05, 0.02, 2 / 9, 1 / 90, 0.123)


def test_message_counts_are_exact_in_2475_rate_and_delay_combinations():
    """Message i of a sender at f_i is there at tick k of f_n if and only if i/f_i + tau <= k/f_n."""
    float_mistakes = 0
    for rate, lag in itertools.product(RATES, LAGS):
        senders = [Accumulate(f"s{f}", f) for f in RATES]
        connections = [Connection(node.name, "agent", lag) for node in senders]
        timing = timed(Graph([*senders, agent(rate, phase=0)], connections), 12)
        tau = Fraction(lag).limit_denominator(1000)
        for edge, f in enumerate(RATES):
            expected = [max((Fraction(k, rate) - tau) * f // 1, -1) for k in range(13)]
            assert timing.windows_of(edge)[:, 0].tolist() == expected
            float_mistakes += expected != [max((k / rate - lag) * f // 1, -1) for k in range(13)]
    assert float_mistakes > 30  # the trap is real in these cases


@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.study) for part in (1, 2, 3))])
def test_times_and_windows_of_a_thousand_graphs_equal_the_oracle(part):
    lost = 0
    for seed in range(250 * part, 250 * (part + 1)):
        random = Random(seed)
        graph, steps, row = random_graph(random, lossy=seed % 2 == 1), random.randint(1, 6), seed // 2 % 2
        timing = timed(graph, steps, batch=2, rows=2)
        run = reference_timing(graph, steps, row)
        exact = lambda ticks: [  # noqa: E731
            Fraction(int(t), timing.resolution) if t < LOST else NEVER  # noqa: B023
            for t in ticks
        ]
        for n, node in enumerate(graph.nodes):
            start, end = timing.steps_of(n, row)
            last = node.name == graph.supervisor  # the end of its last step does not count
            assert exact(start) == run.t_start[node.name]
            assert exact(end[: len(end) - last]) == run.t_end[node.name]
        for e, connection in enumerate(graph.connections):
            assert exact(timing.messages_of(e, row)[1]) == run.t_received[connection.key]
            assert timing.windows_of(e, row).tolist() == run.windows[connection.key]
            lost += run.t_received[connection.key].count(NEVER)
    assert lost > 1000


# The agent waits for n2's message and answers at the same instant, which n2's step cannot see.
@example(graph=random_graph(Random(612), False), steps=3)
@settings(max_examples=100, deadline=None)
@given(graph=graphs(), steps=st.integers(1, 6))
def test_messages_keep_order_are_causal_and_none_is_lost(graph, steps):
    timing = timed(graph, steps)
    for e, connection in enumerate(graph.connections):
        sent, received = timing.messages_of(e)
        assert (received >= sent).all()
        if connection.fifo:
            assert (np.diff(received) >= 0).all()
        start, _ = timing.steps_of(graph.index[connection.receiver])
        windows = timing.windows_of(e)
        for now, window in zip(start, windows, strict=True):
            used = window[window >= 0]
            strictly = connection.skip and not connection.blocking  # a blocking step starts on arrival
            assert (received[used] < now).all() if strictly else (received[used] <= now).all()
            assert len(set(window.tolist())) == connection.window
            there = np.flatnonzero(received < now if connection.skip else received <= now)
            if connection.jitter == "latest" and not connection.blocking and connection.fifo:
                # What arrives at this instant may be an answer to this very step, by a node that waited for it.
                surely = there[(received[there] < now) | (sent[there] < now)]
                assert max(surely, default=-1) <= window[-1] <= max(there, default=-1)
                assert window.tolist() == list(range(window[-1] - connection.window + 1, window[-1] + 1))


def test_each_environment_draws_its_own_delays_and_a_seed_repeats_them():
    graph = chain(Connection("n0", "agent", Gaussian(0.05, 0.02)))
    first, again = timed(graph, 20, batch=3), timed(graph, 20, batch=3)
    assert first.row.tolist() == [0, 1, 2]
    assert len({first.t_received[row].tobytes() for row in range(3)}) == 3
    np.testing.assert_array_equal(first.t_received, again.t_received)


def test_delays_can_be_overridden_by_law_or_for_each_environment():
    graph = chain(Connection("n0", "agent"), phase=0)
    timing = timed(graph, 3, batch=2, delays={"n0->agent": np.array([0.0, 0.15])})
    assert timing.windows_of(0, row=0)[:, 0].tolist() == [0, 1, 2, 3]
    assert timing.windows_of(0, row=1)[:, 0].tolist() == [-1, -1, 0, 1]
    timing = timed(graph, 3, batch=2, delays={"n0": Deterministic(0.1)})
    assert timing.windows_of(0)[:, 0].tolist() == [-1, 0, 1, 2]
    with pytest.raises(TimingError, match=r'delay of "n1".*known: n0, agent, n0->agent'):
        timed(graph, 3, delays={"n1": 0.1})
    with pytest.raises(TimingError, match="expected 1 finite numbers"):
        timed(graph, 3, delays={"n0": [-0.1]})


def test_a_seed_in_the_place_of_a_generator_is_refused():
    graph = chain(Connection("n0", "agent"), phase=0)
    with pytest.raises(TimingError, match=r"generator 0 is no generator; give np.random.default_rng"):
        draw_timing(graph, 0, 5, 1)


def test_a_long_stall_only_makes_the_timing_longer():
    graph = Graph([Accumulate("n0", 100), agent(delay=Listed((900, 0, 0)))], [Connection("n0", "agent")])
    timing = timed(graph, 9)
    # Three stalls of 0.9 s shift the ticks by 0.8 s each: the last start is at 0.9 + 2.4 s.
    assert seconds(timing, "agent")[-1] == 3.3
    assert timing.count(0, 0) == 331


def test_stalls_are_as_frequent_as_their_law_says():
    """One step in ten stalls for 2 s, in which the node at 1000 Hz needs 13 times its planned steps."""
    stalling = Accumulate("n0", 10, delay=Mixture((Deterministic(0.01), Deterministic(2.0)), (0.9, 0.1)))
    nodes = [stalling, Accumulate("n1", 1000), agent()]
    graph = Graph(nodes, [Connection("n0", "agent", blocking=True), Connection("n1", "agent")])
    generator, stalls = np.random.default_rng(0), []
    for _ in range(150):
        timing = draw_timing(graph, generator, 1, 2)
        for row in range(2):
            start, end = timing.steps_of(0, row)
            stalls.append(end[0] - start[0] > timing.resolution)
    assert 0.05 < np.mean(stalls) < 0.15


def test_nodes_that_drive_each_other_without_a_clock_are_refused():
    nodes = [Accumulate("n0", 10, advance=True), agent()]
    connections = [Connection("n0", "n0", skip=True, blocking=True), Connection("n0", "agent")]
    with pytest.raises(TimingError, match=r"does not come to its step 5: .*advance=True"):
        timed(Graph(nodes, connections), 5)


def test_a_longer_timing_begins_as_the_shorter_one():
    nodes = [Accumulate("n0", 30, Gaussian(0.01, 0.01)), agent(delay=Autoregressive(Gamma(2, 0.005), 0.9))]
    loop = [Connection("n0", "agent", Lossy(Gaussian(0.03, 0.02), 0.1)), Connection("agent", "n0", skip=True)]
    graph = Graph(nodes, loop, stalls=[Stalls(1.0, 0.1)])
    short, long = timed(graph, 7, batch=3), timed(graph, 400, batch=3)
    again = extend_timing(short, 400)
    np.testing.assert_array_equal(again.t_received, long.t_received)
    np.testing.assert_array_equal(again.windows, long.windows)
    for row in range(3):
        for n in range(2):
            start, _ = short.steps_of(n, row)
            np.testing.assert_array_equal(start, long.steps_of(n, row)[0][: len(start)])
        windows = short.windows_of(0, row)
        np.testing.assert_array_equal(windows, long.windows_of(0, row)[: len(windows)])
    some = extend_timing(short.take(np.array([2, 0, 2])), 400)
    np.testing.assert_array_equal(some.t_start[some.row[0]], long.t_start[2])
    with pytest.raises(TimingError, match="7 steps already; 3 are fewer"):
        extend_timing(short, 3)
    with pytest.raises(TimingError, match="measured or joined"):
        extend_timing(concatenate(graph, [short, short]), 9)


def test_there_can_be_more_schedules_than_environments():
    graph = chain(Connection("n0", "agent", Gaussian(0.05, 0.02)))
    pool = timed(graph, 5, batch=2, rows=7)
    assert pool.row.tolist() == [0, 1]
    assert len({row.tobytes() for row in pool.t_received}) == 7
    np.testing.assert_array_equal(pool.t_received, timed(graph, 5, batch=7).t_received)


def test_each_schedule_can_have_parameters_of_its_own():
    graph = chain(Connection("n0", "agent"), phase=0)
    means = np.array([0.01, 0.2, 0.05])
    law = {"law": "gaussian", "loc": torch.tensor(means), "scale": 0.001}
    timing = timed(graph, 200, batch=3, delays={"n0->agent": law})
    for row in range(3):
        sent, received = timing.messages_of(0, row)
        delay = (received - sent)[:190] / timing.resolution
        assert abs(delay.mean() - means[row]) < 0.0005
        assert 0.0005 < delay.std() < 0.0015
    mixed = [Deterministic(0.02), {"law": "uniform", "low": 0.03, "high": 0.04}, Autoregressive(0.05, 0.5)]
    timing = timed(graph, 20, batch=3, delays={"n0->agent": mixed})
    for row, (low, high) in enumerate([(0.02, 0.02), (0.03, 0.04), (0.05, 0.05)]):
        sent, received = timing.messages_of(0, row)
        delay = np.round((received - sent) / timing.resolution, 9)
        assert (delay >= low).all()
        assert (delay <= high).all()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ({"law": "gaussian", "loc": np.array([0.1, 0.2]), "scale": 0.1}, r"loc: expected 3 finite .*\(2,\)"),
        (
            {"law": "gaussian", "loc": np.array([0.1, -0.2, 0.1]), "scale": 0.1},
            "schedule 1: loc: -0.2 s is no",
        ),
        ([Deterministic(0.1), Deterministic(0.2)], "expected 3 laws, one each, got 2"),
        (np.zeros((3, 2)), r"expected 3 finite .* got shape \(3, 2\)"),
        (float("nan"), "nan s is no delay"),
        ("soon", "finite numbers of seconds"),
    ],
)
def test_delays_of_a_reset_that_do_not_fit_are_refused(override, message):
    with pytest.raises(TimingError, match='delay of "n0->agent": .*' + message):
        timed(chain(Connection("n0", "agent")), 3, batch=3, delays={"n0->agent": override})


def test_a_lost_message_holds_nothing_back_and_is_waited_for_until_it_is_sent():
    # Message 1 is lost; sent at 0.12 s (computation 20 ms), which is when the step at 0.1 s goes on.
    connection = Connection("n0", "agent", Listed((10, -1, 10, 10)), blocking=True)
    timing = timed(chain(connection, sender_delay=Listed((20,)), phase=0), 3)
    np.testing.assert_allclose(seconds(timing, "agent"), [0.03, 0.12, 0.23, 0.33], rtol=1e-12)
    assert timing.windows_of(0)[:, 0].tolist() == [0, 0, 2, 3]


def test_a_stall_holds_up_what_is_under_way_and_what_begins_in_it():
    # Stall from 15 to 45 ms. n0 (100 Hz, 2 ms): the step at 10 ms is done before, that at 20 ms ends at 47.
    stall = ListedStalls(1.0, 0.0, listed=((15, 30),))
    nodes = [Accumulate("n0", 100, Listed((2,))), agent(20, phase=0)]
    graph = Graph(nodes, [Connection("n0", "agent", Listed((4,)))], stalls=[stall])
    timing = timed(graph, 1)
    start, end = timing.steps_of(0)
    assert (start[:4] / timing.resolution).tolist() == [0.0, 0.01, 0.02, 0.047]
    assert (end[:4] / timing.resolution).tolist() == [0.002, 0.012, 0.047, 0.049]
    # The message sent at 12 ms has 3 of its 4 ms behind it when the stall comes: there at 46 ms.
    assert (timing.messages_of(0)[1][:3] / timing.resolution).tolist() == [0.006, 0.046, 0.051]


def test_recorded_delays_are_played_together_and_each_once_a_round():
    # Two recordings in which the delay tells recording and place; both channels have the same.
    recordings = [{k: (np.arange(5) + 10 * r) / 1000 for k in ("n0", "n0->agent")} for r in (1, 2)]
    graph = Graph([Accumulate("n0", 10), agent()], [Connection("n0", "agent")])
    timing = timed(graph, 60, batch=4, traces=RecordedDelays(recordings))
    orders = set()
    for row in range(4):
        start, end = timing.steps_of(0, row)
        sent, received = timing.messages_of(0, row)
        played = np.rint((end - start) / timing.resolution * 1000).astype(int)[:60]
        np.testing.assert_array_equal(played, np.rint((received - sent)[:60] / timing.resolution * 1000))
        for round_ in played.reshape(-1, 10):
            assert sorted(round_.tolist()) == [*range(10, 15), *range(20, 25)]
            assert len({n // 10 for n in round_[:5].tolist()}) == 1
        orders.add(tuple(played.tolist()))
    assert len(orders) == 4
    np.testing.assert_array_equal(
        timing.t_end, extend_timing(timed(graph, 3, 4, traces=RecordedDelays(recordings)), 60).t_end
    )


def test_recordings_that_do_not_fit_are_refused():
    graph = Graph([Accumulate("n0", 10), agent()], [Connection("n0", "agent")])
    with pytest.raises(TimingError, match='"n1": no such node'):
        timed(graph, 3, traces=RecordedDelays([{"n1": np.ones(3)}]))
    with pytest.raises(TimingError, match='"n0": a computation cannot get lost'):
        timed(graph, 3, traces=RecordedDelays([{"n0": np.array([0.1, np.inf])}]))
    with pytest.raises(DelayError, match='recording 1, "n0", number 1 of'):
        RecordedDelays([{"n0": np.ones(3)}, {"n0": np.array([0.1, -0.1])}])
    with pytest.raises(DelayError, match="recording 1 and recording 0 differ in n1"):
        RecordedDelays([{"n0": np.ones(3)}, {"n0": np.ones(3), "n1": np.ones(3)}])
    with pytest.raises(DelayError, match="there is no recording"):
        RecordedDelays([])
