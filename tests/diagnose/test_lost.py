"""Which commands never arrived is found tick by tick, and nothing is found where all arrived."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import refit_sharply, start_from
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.loss_pattern import held_over, pattern
from deepkoco.diagnose.lost import LostCommands, lost_commands
from deepkoco.graph.recording import Recording
from deepkoco.identify.fit import FitProblem
from deepkoco.systems import make_system
from experiments.hidden.excitations import Drive
from experiments.hidden.unit import hidden_log

SECONDS, SEED = 12.0, 171


def unit(share: float, excitation: str = "chirp") -> Recording:
    return hidden_log("rod_pendulum", {"lost_commands": {"share": share}}, excitation, SEED, SECONDS)


def search(log: Recording):
    base = make_system("rod_pendulum")
    data = cut_data([log], (), base, 1.6)
    start = start_from(base, data.train)
    train, reference = refit_sharply(start, data.train)
    return lost_commands(FitProblem(start.system, train), reference, start.prior, 0)


def test_losses_explain_what_the_refit_leaves_and_their_share_is_right():
    found = search(unit(0.08))
    assert 0.04 < found.share < 0.12
    assert found.fit.chi2 / found.problem.windows.samples < 1.1
    assert found.found == found.logs[0].lost.sum()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_where_responses_differ_every_tick_is_found(seed):
    rng = np.random.default_rng(seed)
    sent = rng.choice([-1.0, 1.0], 25).cumsum()
    truth = rng.random(24) < 0.3
    response = 20.0 * rng.standard_normal((400, 24))
    acted = held_over(sent, 1 + np.flatnonzero(truth))[1:]
    residual = response @ (acted - sent[1:]) + rng.standard_normal(400)
    gram, match = response.T @ response, response.T @ residual
    # From nothing, and from the truth; the price of a tick is small beside what it wins.
    for before, left in ((np.zeros(24, dtype=bool), match), (truth, response.T @ rng.standard_normal(400))):
        lost = pattern(gram, left, sent, before, 4.0, 4.0)
        assert (held_over(sent, 1 + np.flatnonzero(lost))[1:] == acted).all()


def test_nothing_is_lost_where_every_command_arrived():
    assert search(unit(0.0)) is None


def test_what_healthy_logs_lose_as_well_is_no_cause():
    lossy = {"lost_commands": {"share": 0.08}}
    healthy = hidden_log("rod_pendulum", lossy, "chirp", SEED, SECONDS, take=1)
    result = diagnose([unit(0.08)], "rod_pendulum", healthy=[healthy], only=["lost_commands"])
    assert result.verdict == "nothing"
    assert "the healthy logs lose some of it, too" in result.unexplained["lost_commands_not_searched"]


def test_a_log_that_never_moved_is_no_obstacle():
    hanging = Drive([np.pi], [0.0], lambda t, reading: [0.0])
    still = hidden_log("rod_pendulum", {}, hanging, SEED, SECONDS)
    result = diagnose([still, unit(0.08)], "rod_pendulum", only=["lost_commands"])
    assert result.names == ("lost_commands",)


def test_without_a_regular_pace_a_lost_tick_has_no_length():
    log = unit(0.08)
    sent = log.channels["torque"]
    keep = np.random.default_rng(0).random(len(sent)) < 0.5
    keep[0] = True
    thinned = replace(sent, t=sent.t[keep], value=sent.value[keep])
    assert search(replace(log, channels={**log.channels, "torque": thinned})) is None


@given(st.lists(st.booleans(), min_size=1, max_size=30))
def test_a_lost_tick_holds_what_acted_before_it(lost):
    sent = np.arange(1.0, len(lost) + 2.0)
    acted = held_over(sent, 1 + np.flatnonzero(lost))
    expected = sent[0]
    for k, gone in enumerate(lost):
        expected = expected if gone else sent[k + 1]
        assert acted[k + 1] == expected


def test_the_charge_is_the_length_of_the_code():
    # 5 of 50 ticks: 2,118,760 patterns; one parameter at 1000 samples: log(1000) = 6.9. Of all, there is one pattern.
    windows = SimpleNamespace(samples=1000)
    found = LostCommands(0, (), SimpleNamespace(windows=windows), SimpleNamespace(), 5, 50, 50, 5, 4.0)
    assert found.charge == pytest.approx(2 * np.log(2_118_760) + 6.907755, rel=1e-6)
    assert replace(found, found=50).charge == pytest.approx(6.907755, rel=1e-6)
