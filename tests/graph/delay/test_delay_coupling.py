"""What ties one delay to another: correlation in time and across channels, and shared stalls."""

import math

import numpy as np
import pytest
import torch
import yaml
from scipy.stats import kstest, spearmanr

from deepkoco.graph import (
    Connection,
    DelayError,
    Deterministic,
    Empirical,
    Gaussian,
    Graph,
    Mixture,
    Supervisor,
    draw_timing,
)
from deepkoco.graph.delay import (
    Autoregressive,
    Gamma,
    Lossy,
    OrnsteinUhlenbeck,
    OverrunProcess,
    RankCorrelation,
    Stalls,
    make_correlation,
    make_stalls,
)
from tests.graph.timing_reference import Accumulate

MIXED = Mixture((Gaussian(0.01, 0.002), Gamma(2, 0.02)), (3, 1))


def agent(rate=10) -> Supervisor:
    return Supervisor("agent", rate, initial_action=torch.zeros(1))


def lag(draws: np.ndarray, step: int) -> float:
    """Spearman's correlation of draws that are `step` apart."""
    return float(spearmanr(draws[:, :-step].ravel(), draws[:, step:].ravel()).statistic)


@pytest.mark.parametrize("factor", [0.8, -0.5])
def test_correlated_draws_keep_the_marginal_law(factor):
    draws = Autoregressive(MIXED, factor).stream(300, 1.0).draw(np.random.default_rng(0), 60)
    # Far apart they are independent, so every 30th can be tested against the law itself.
    assert kstest(draws[:, ::30].ravel(), MIXED.cdf).pvalue > 0.01
    assert kstest(draws[:, 0], MIXED.cdf).pvalue > 0.01
    # Spearman of a bivariate normal with correlation r is (6 / pi) asin(r / 2).
    for step in (1, 2):
        expected = 6 / math.pi * math.asin(factor**step / 2)
        assert lag(draws, step) == pytest.approx(expected, abs=0.03)


def test_the_correlation_of_an_ornstein_uhlenbeck_law_is_in_seconds():
    law = OrnsteinUhlenbeck(Gaussian(0.1, 0.01), 0.5)
    for period in (0.01, 0.25):
        draws = law.stream(200, period).draw(np.random.default_rng(0), 400)
        expected = 6 / math.pi * math.asin(math.exp(-period / 0.5) / 2)
        assert lag(draws, 1) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("law", [Autoregressive(MIXED, 0.9), OverrunProcess(0.1, 0.3), Gamma(2, 0.1)])
def test_a_stream_goes_on_where_it_was(law):
    """Two draws after each other are as one, for laws that take one normal number a draw."""
    whole = law.stream(1, 1.0).draw(np.random.default_rng(3), 20)
    stream, generator = law.stream(1, 1.0), np.random.default_rng(3)
    parts = [stream.draw(generator, n) for n in (1, 7, 12)]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole)


def test_the_overrun_process_follows_its_equation():
    law = OverrunProcess(period=0.1, sigma=0.3, theta=0.07)
    x, noise = 0.0, np.random.default_rng(5).standard_normal(200)
    expected = []
    for nu in noise:
        x = (1 - 0.07) * x + 0.3 * nu
        expected.append(0.1 * max(1.0, 1.0 + x))
    np.testing.assert_allclose(
        law.stream(1, 1.0).draw(np.random.default_rng(5), 200)[0], expected, rtol=1e-12
    )
    # A node with this delay starts a step after each.
    graph = Graph([agent(), Accumulate("n0", 10, law)], [Connection("n0", "agent")])
    start, end = draw_timing(graph, np.random.default_rng(0), 50, 1).steps_of(1)
    np.testing.assert_array_equal(start[1:], end[:-1])


@pytest.mark.parametrize("rho", [0.8, -0.6])
def test_channels_of_one_publisher_have_the_rank_correlation_asked_for(rho):
    nodes = [Accumulate("s", 50), agent(), Accumulate("r", 50)]
    laws = (
        Autoregressive(MIXED, 0.5),
        Lossy(Autoregressive(Empirical(tuple(np.arange(1, 999) / 1e5)), 0.4), 0.1),
    )
    connections = [
        Connection("s", "agent", laws[0], fifo=False),
        Connection("s", "r", laws[1], fifo=False),
    ]
    tied = {"channels": ["s->agent", "s->r"], "value": rho}
    graph = Graph(nodes, connections, correlations=[tied])
    timing = draw_timing(graph, np.random.default_rng(0), 200, 40)
    delays = []
    for e in range(2):
        pairs = [timing.messages_of(e, row) for row in range(40)]
        delays.append(np.stack([(received - sent)[:900] / timing.resolution for sent, received in pairs]))
    arrived = delays[1] < 10
    assert arrived.mean() == pytest.approx(0.9, abs=0.01)
    assert spearmanr(delays[0][arrived], delays[1][arrived]).statistic == pytest.approx(rho, abs=0.03)
    assert spearmanr(delays[0][:, 0], delays[1][:, 0]).statistic == pytest.approx(rho, abs=0.25)
    assert lag(delays[0], 1) == pytest.approx(6 / math.pi * math.asin(0.25), abs=0.03)
    assert kstest(delays[0][:, ::30].ravel(), MIXED.cdf).pvalue > 0.01


def test_correlations_that_no_joint_law_has_are_refused():
    with pytest.raises(DelayError, match="a and b and c: no joint law"):
        RankCorrelation(("a", "b", "c"), ((1, 0.9, 0.9), (0.9, 1, -0.9), (0.9, -0.9, 1)))
    with pytest.raises(DelayError, match="a and b: expected a symmetric 2 x 2 matrix"):
        RankCorrelation(("a", "b"), ((1, 0.9), (0.8, 1)))
    with pytest.raises(DelayError, match="not two or more different channels"):
        RankCorrelation(("a",), 0.5)
    # Scores of one that hardly changes cannot follow one that is new each time.
    with pytest.raises(DelayError, match="together with the autocorrelations"):
        RankCorrelation(("a", "b"), 0.9).roots(np.array([0.99, 0.0]))


def test_correlations_and_stalls_survive_yaml():
    for item, make in (
        (RankCorrelation(("a", "b"), 0.8), make_correlation),
        (RankCorrelation(("a", "b"), ((1.0, 0.3), (0.3, 1.0))), make_correlation),
        (Stalls(0.1, Gaussian(0.1, 0.02), 2.0, ("a", "b->c")), make_stalls),
        (Stalls(0.1, 0.2), make_stalls),
    ):
        assert make(yaml.safe_load(yaml.safe_dump(item.to_dict()))) == item


def test_stalls_come_at_their_rate_and_keep_their_distance():
    stalls = Stalls(rate=0.5, duration=Gaussian(0.1, 0.02), refractory=1.0)
    begin, end = stalls.stream(400).draw(np.random.default_rng(0), 30)
    assert (begin[:, 1:] - end[:, :-1]).min() >= 1.0 - 1e-9
    assert (end - begin).mean() == pytest.approx(0.1, abs=0.001)
    # From the first second on as often as in the long run: the process has always been going on.
    for low, high in ((0.0, 1.0), (5.0, 15.0)):
        count = ((begin >= low) & (begin < high)).sum() / 400
        assert count == pytest.approx(0.5 * (high - low), rel=0.12)


def test_one_stall_hits_every_node_that_would_run():
    nodes = [Accumulate("a", 100, 0.002), Accumulate("b", 50, 0.001), agent()]
    connections = [Connection("a", "agent"), Connection("b", "agent")]
    graph = Graph(nodes, connections, stalls=[Stalls(0.2, 0.1, refractory=1.0)])
    assert not graph.constant
    timing = draw_timing(graph, np.random.default_rng(0), 600, 5)
    for row in range(5):
        held = []
        for n, usual in ((0, 0.002), (1, 0.001)):
            start, end = (t / timing.resolution for t in timing.steps_of(n, row))
            late = np.flatnonzero(end - start > usual + 1e-9)
            assert (end - start)[late].max() <= usual + 0.1 + 1e-9
            held.append(end[late] - usual)
        # Both end what they do as soon as the stall is over, so within their own computation time.
        assert len(held[0]) == len(held[1]) > 3
        np.testing.assert_allclose(held[0], held[1], atol=0.003)


def test_stalls_that_do_not_fit_into_time_are_refused():
    with pytest.raises(DelayError, match=r"3.0 stalls a second of 0.2 s with 0.5 s between"):
        Stalls(3, 0.2, 0.5)
    with pytest.raises(DelayError, match=r"rate .Hz.: -1.0 is not in"):
        Stalls(-1, 0.2)
    with pytest.raises(DelayError, match="one name; give a list"):
        Stalls(1, 0.2, channels="a")
    with pytest.raises(DelayError, match="durations are independent and finite, not lossy"):
        Stalls(1, Lossy(Deterministic(0.1), 0.5))
