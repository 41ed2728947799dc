"""hidden_delays on motion simulated by an independent integrator."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from deepkoco.fit import FitError, HiddenDelays, Identification, fit, hidden_delays
from deepkoco.graph.delay import Gaussian, Mixture
from deepkoco.logs.recording import Recording, Series

STEP, PERIOD = 0.001, 0.05  # integration, time between commands [s]


def rod_log(delays: np.ndarray, seed: int = 0) -> Recording:
    """A rod pendulum under random torques; each torque acts after its own delay."""
    rng = np.random.default_rng(seed)
    sent = PERIOD * np.arange(len(delays))
    torque = rng.uniform(-2.0, 2.0, len(delays))
    # Without half of the recent mean torque, the rod does not rotate.
    torque -= 0.5 * np.convolve(torque, np.ones(8) / 8)[: len(torque)]
    torque = np.clip(torque, -2.0, 2.0)
    acts = np.maximum.accumulate(sent + delays)
    count = round((sent[-1] + PERIOD) / STEP)
    state, states = np.array([math.pi, 0.0]), np.zeros((count, 2))
    level = np.searchsorted(acts, STEP * (np.arange(count) + 0.5)) - 1
    for i in range(count):
        states[i] = state
        u = torque[level[i]] if level[i] >= 0 else 0.0

        def slope(x, u=u):
            return np.array([x[1], 15.0 * math.sin(x[0]) + 3.0 * u - 0.9 * x[1]])

        middle = state + 0.5 * STEP * slope(state)
        state = state + STEP * slope(middle)
    t = STEP * np.arange(count)[::5]
    theta = states[::5, 0] + 0.001 * rng.standard_normal(len(t))
    omega = states[::5, 1] + 0.02 * rng.standard_normal(len(t))
    return Recording(
        {
            "torque": Series(sent, torque, "N m", "command"),
            "theta": Series(t, theta, "rad", "measurement"),
            "omega": Series(t, omega, "rad/s", "measurement"),
        },
        system="rod_pendulum",
    )


@lru_cache
def drawn(kind: str) -> np.ndarray:
    """True delays of 400 messages [s]."""
    rng, count = np.random.default_rng(7), 400
    return {
        "constant": np.full(count, 0.02),
        "gaussian": 0.02 + 0.003 * rng.standard_normal(count),
        "mixture": np.where(rng.random(count) < 0.7, 0.01, 0.035) + 0.001 * rng.standard_normal(count),
    }[kind]


@lru_cache
def found(kind: str) -> Identification:
    return fitted(rod_log(drawn(kind)))


def fitted(log: Recording) -> Identification:
    return fit([log], "rod_pendulum", ["actuation_delay.delay"], start={"viscous": 0.3})


def rounded_otherwise(log: Recording) -> Recording:
    """The same log, every measurement off by some last bits, as another processor may have it."""
    rng = np.random.default_rng(3)
    channels = {
        name: replace(series, value=series.value * (1.0 + 1e-12 * rng.standard_normal(len(series.value))))
        for name, series in log.channels.items()
    }
    return replace(log, channels=channels)


def other_order(result: Identification) -> Identification:
    """The same fit, its windows from last to first."""
    order = np.arange(len(result.request.windows))[::-1].copy()
    request = replace(result.request, windows=result.request.windows.take(order))
    return replace(result, request=request, fit=replace(result.fit, state=result.fit.state[order]))


def other_start(result: Identification, later: float) -> Identification:
    """The same fit, its delay off by so much [s]."""
    delay = {"actuation_delay.delay": result.fit.values["actuation_delay.delay"] + later}
    return replace(result, fit=replace(result.fit, values=result.fit.values | delay))


@lru_cache
def mixture() -> HiddenDelays:
    return hidden_delays(found("mixture"), components=2)


def standard_errors(law: HiddenDelays) -> np.ndarray:
    """(2, C) of the means and of the spreads [s], were every delay measured: the true ones are larger."""
    size = law.weights * len(law.sent)
    return np.stack([law.spreads / np.sqrt(size), law.spreads / np.sqrt(2.0 * size)])


def assert_the_same(law: HiddenDelays, other: HiddenDelays, share: float) -> None:
    """Agreement of two laws within a share of their standard errors."""
    mean_sd, spread_sd = share * standard_errors(law)
    assert (np.abs(other.means - law.means) < mean_sd).all()
    assert (np.abs(other.spreads - law.spreads) < spread_sd).all()
    assert other.weights == pytest.approx(law.weights, abs=share * 0.025)


def test_hidden_delays_recover_mean_spread_and_each_message():
    result = hidden_delays(found("gaussian"))
    true = drawn("gaussian")[np.round(result.sent / PERIOD).astype(int)]
    assert result.mean == pytest.approx(true.mean(), abs=0.0003)
    assert result.spread == pytest.approx(true.std(), rel=0.1)
    assert result.spread_interval[0] < true.std() < result.spread_interval[1]
    score = (result.delay - true) / result.delay_sd
    assert np.sqrt((score**2).mean()) == pytest.approx(1.0, abs=0.2)  # the posterior sd is calibrated
    assert result.evidence > 10.0
    assert isinstance(result.law, Gaussian)


def test_hidden_delays_report_no_evidence_for_a_constant_delay():
    result = hidden_delays(found("constant"))
    assert result.mean == pytest.approx(0.02, abs=0.0003)
    assert result.spread < 0.0006
    assert result.evidence < 10.0


@pytest.mark.study
def test_hidden_delays_recover_a_mixture():
    result = mixture()
    true = drawn("mixture")[np.round(result.sent / PERIOD).astype(int)]
    short = true < 0.02
    assert result.means == pytest.approx([true[short].mean(), true[~short].mean()], abs=0.0005)
    assert result.weights == pytest.approx([short.mean(), 1.0 - short.mean()], abs=0.04)
    # The spreads are 1 ms each, less than the posterior sd of a single delay.
    assert result.spreads == pytest.approx([true[short].std(), true[~short].std()], rel=0.35)
    assert isinstance(result.law, Mixture)


@pytest.mark.study
def test_hidden_delays_of_a_mixture_are_independent_of_rounding_of_the_log():
    other = hidden_delays(fitted(rounded_otherwise(rod_log(drawn("mixture")))), components=2)
    assert_the_same(mixture(), other, 0.02)


@pytest.mark.study
def test_hidden_delays_of_a_mixture_are_independent_of_draws_order_and_start():
    # Other draws fall to each message: what differs is the error of the Monte Carlo average.
    other = other_order(other_start(found("mixture"), 0.004))
    assert_the_same(mixture(), hidden_delays(other, components=2, seed=1), 0.2)


@pytest.mark.study
@pytest.mark.parametrize("kind", ["constant", "gaussian"])
def test_hidden_delays_of_a_normal_law_are_independent_of_rounding_and_order(kind):
    first = hidden_delays(found(kind))
    for other in (fitted(rounded_otherwise(rod_log(drawn(kind)))), other_order(found(kind))):
        again = hidden_delays(other)
        assert again.mean == pytest.approx(first.mean, abs=1e-8)
        assert again.spread == pytest.approx(first.spread, abs=1e-8)
        assert again.spread_interval == pytest.approx(first.spread_interval, abs=1e-8)
        assert again.evidence == pytest.approx(first.evidence, rel=1e-5, abs=1e-3)


def test_hidden_delays_refuse_too_few_changes():
    with pytest.raises(FitError, match="changes often"):
        hidden_delays(found("constant"), components=60)
