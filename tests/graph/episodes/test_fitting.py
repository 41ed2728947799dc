"""A delay model fitted from delays that were drawn from a known one finds it again."""

import numpy as np
import pytest
import torch
import yaml
from scipy.stats import kstest
from sklearn.mixture import GaussianMixture

from deepkoco.graph import (
    Connection,
    Empirical,
    Episode,
    Gaussian,
    Graph,
    MeasuredTiming,
    Mixture,
    Supervisor,
    draw_timing,
)
from deepkoco.graph.delay import Autoregressive, LogNormal, Lossy, RankCorrelation, Stalls
from deepkoco.graph.episodes.fitting import DelayModel, FitError, fit_delays
from deepkoco.graph.episodes.fitting.mixture_fit import expectation_maximisation, fit_mixture
from deepkoco.graph.timing.kernel import LOST
from tests.graph.timing_reference import Accumulate

TWO = Mixture((Gaussian(0.008, 0.0004), Gaussian(0.012, 0.001)), (0.7, 0.3))


def recorded(graph: Graph, steps: int) -> MeasuredTiming:
    timing = draw_timing(graph, np.random.default_rng(1), steps, 1)
    nodes = [[t / timing.resolution for t in timing.steps_of(n)] for n in range(len(graph.nodes))]
    received = [timing.messages_of(e)[1] for e in range(len(graph.connections))]
    return MeasuredTiming(
        {node.name: start for node, (start, _) in zip(graph.nodes, nodes, strict=True)},
        {node.name: end for node, (_, end) in zip(graph.nodes, nodes, strict=True)},
        {
            c.key: np.where(ticks < LOST, ticks / timing.resolution, np.inf)
            for c, ticks in zip(graph.connections, received, strict=True)
        },
    )


def test_a_recorded_graph_gives_back_its_delay_model():
    nodes = [
        Accumulate("sensor", 50, Autoregressive(TWO, 0.6)),
        Accumulate("plot", 20, 0.001),
        Supervisor("agent", 50, initial_action=torch.zeros(1), delay=LogNormal(0.003, 0.3)),
    ]
    connections = [
        Connection("sensor", "agent", LogNormal(0.002, 0.3), fifo=False),
        Connection("sensor", "plot", LogNormal(0.001, 0.2), fifo=False),
        Connection("agent", "plot", Lossy(LogNormal(0.002, 0.2), 0.05), fifo=False),
    ]
    correlations = [RankCorrelation(("sensor->agent", "sensor->plot"), 0.8)]
    graph = Graph(
        nodes, connections, correlations=correlations, stalls=[Stalls(0.1, Gaussian(0.1, 0.01), 5.0)]
    )
    model = fit_delays(recorded(graph, 4000))
    assert kstest(TWO.quantile(np.linspace(0.0005, 0.9995, 1000)), model.laws["sensor"].cdf).statistic < 0.04
    assert model.laws["sensor"].autocorrelation(0.02) == pytest.approx(0.6, abs=0.05)
    assert model.laws["agent"].mean == pytest.approx(0.00314, rel=0.03)
    assert model.laws["agent"].autocorrelation(0.02) == 0.0
    lossy = model.laws["agent->plot"]
    assert isinstance(lossy, Lossy)
    assert lossy.probability == pytest.approx(0.05, abs=0.01)
    (tied,) = model.correlations
    assert set(tied.channels) == {"sensor->agent", "sensor->plot"}
    assert np.array(tied.value)[0, 1] == pytest.approx(0.8, abs=0.03)
    (stalls,) = model.stalls
    # 80 s with a stall every 10 s on average; each is seen as the longest that it held anything up.
    assert stalls.rate == pytest.approx(0.1, abs=0.05)
    assert stalls.law.mean == pytest.approx(0.1, abs=0.015)
    assert 4.0 < stalls.refractory < 9.0
    # The model describes itself, and the graph runs with it.
    assert DelayModel.from_dict(yaml.safe_load(yaml.safe_dump(model.to_dict()))) == DelayModel(
        model.laws, model.correlations, model.stalls
    )
    draw_timing(
        graph,
        np.random.default_rng(0),
        50,
        2,
        model.laws,
        correlations=model.correlations,
        stalls=model.stalls,
    )


def test_the_mixture_is_as_likely_as_an_independent_implementation_finds():
    samples = TWO.sample(np.random.default_rng(0), (3000,))
    points = np.sort(samples)
    weights, means, deviations = expectation_maximisation(points, np.ones(3000), 2)
    oracle = GaussianMixture(2, random_state=0, tol=1e-8, max_iter=500, reg_covar=1e-12).fit(samples[:, None])
    order = np.argsort(oracle.means_[:, 0])
    np.testing.assert_allclose(means, oracle.means_[order, 0], rtol=2e-3)
    np.testing.assert_allclose(weights, oracle.weights_[order], rtol=2e-2)
    np.testing.assert_allclose(deviations, np.sqrt(oracle.covariances_[order, 0, 0]), rtol=2e-2)


@pytest.mark.parametrize(
    ("law", "kind", "size"),
    [(TWO, Gaussian, 2), (Gaussian(0.02, 0.002), Gaussian, 1), (LogNormal(0.01, 0.6), LogNormal, 1)],
)
def test_bic_finds_family_and_number_of_components(law, kind, size):
    fitted = fit_mixture(law.sample(np.random.default_rng(0), (4000,)))
    components = fitted.components if isinstance(fitted, Mixture) else (fitted,)
    assert [type(component) for component in components] == [kind] * size


@pytest.mark.parametrize("law", [TWO, Gaussian(0.02, 0.002), LogNormal(0.01, 0.6)])
@pytest.mark.parametrize("seed", range(3))
def test_a_mixture_does_not_hang_on_rounding_or_order(law, seed):
    rng = np.random.default_rng(seed)
    samples = law.sample(rng, (1000,))
    first = fit_mixture(samples)
    other = fit_mixture(rng.permutation(samples * (1.0 + 1e-12 * rng.standard_normal(1000))))
    levels = np.array([0.01, 0.1, 0.5, 0.9, 0.99])
    np.testing.assert_allclose(other.quantile(levels), first.quantile(levels), rtol=1e-8)
    assert type(other) is type(first)


def test_a_constant_delay_between_rounded_stamps_is_constant():
    sent = 0.02 * np.arange(500)
    delays = (sent + 0.01) - sent
    assert len(np.unique(delays)) > 1
    law = fit_delays({"sensor": delays}).laws["sensor"]
    assert law.constant
    assert law.mean == pytest.approx(0.01, abs=1e-9)


def test_arrays_with_rates_and_an_empirical_law():
    samples = TWO.sample(np.random.default_rng(0), (500,))
    model = fit_delays({"sensor": samples}, {"sensor": 50.0}, family="empirical", warm_up=2.0)
    assert model.laws["sensor"] == Empirical(tuple(samples[100:].tolist()))
    assert model.stalls == ()
    assert fit_delays({"sensor": np.full(20, 0.01)}).laws["sensor"].constant


@pytest.mark.parametrize(
    ("delays", "options", "message"),
    [
        ({"a": np.array([0.1, -0.1] * 9)}, {}, '"a": sample 1 is -0.1 s'),
        ({"a": np.array([0.1, np.nan] * 9)}, {}, '"a": sample 1 is nan s'),
        ({"a": np.full(12, np.inf)}, {}, '"a": 0 delays after the warm-up'),
        ({"a": np.array([np.inf] + [0.1] * 20)}, {}, '"a": sample 0 is infinite; a step has an end'),
        ({"a": np.ones((3, 4))}, {}, r'"a": delays have shape \(3, 4\)'),
        ({"a": np.ones(20)}, {"rates": {"a": -1.0}}, '"a": no rate, or one that is not positive'),
        ({"a": np.ones(20)}, {"family": "normal"}, 'family "normal" is none of'),
        ({}, {}, "no channel"),
    ],
)
def test_what_cannot_be_fitted_is_refused(delays, options, message):
    with pytest.raises(FitError, match=message):
        fit_delays(delays, **options)


def test_the_last_step_of_a_supervisor_which_only_starts_is_no_delay():
    start = np.arange(40) * 0.02
    taken = np.append(0.004 + 0.0001 * np.arange(39), 0.0)  # as the wall clock records it
    outputs = {"agent": np.zeros((39, 1))}
    episode = Episode({"agent": start}, {"agent": start + taken}, outputs, {}, {}, {})
    law = fit_delays(episode, family="empirical").laws["agent"]
    law = law.delay if isinstance(law, Autoregressive) else law
    assert isinstance(law, Empirical)
    np.testing.assert_allclose(np.sort(law.samples), taken[:-1], atol=1e-12)
