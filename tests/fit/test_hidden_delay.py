"""hidden_delays on motion simulated by an independent integrator."""

import math
from functools import lru_cache

import numpy as np
import pytest

from deepkoco.fit import FitError, Identification, fit, hidden_delays
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
    asked = ["actuation_delay.delay"]
    return fit([rod_log(drawn(kind))], "rod_pendulum", asked, start={"viscous": 0.3})


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


def test_hidden_delays_recover_a_mixture():
    result = hidden_delays(found("mixture"), components=2)
    true = drawn("mixture")[np.round(result.sent / PERIOD).astype(int)]
    short = true < 0.02
    assert result.means == pytest.approx([true[short].mean(), true[~short].mean()], abs=0.0005)
    assert result.weights == pytest.approx([short.mean(), 1.0 - short.mean()], abs=0.04)
    # The spreads are 1 ms each, less than the posterior sd of a single delay.
    assert result.spreads == pytest.approx([true[short].std(), true[~short].std()], rel=0.35)
    assert isinstance(result.law, Mixture)


def test_hidden_delays_refuse_too_few_changes():
    with pytest.raises(FitError, match="changes often"):
        hidden_delays(found("constant"), components=60)
