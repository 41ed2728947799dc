"""Search for lost commands tick by tick."""

import math
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import LosingCommands, baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.evidence.selection import FURTHER
from deepkoco.diagnose.lost_commands import search as search_module
from deepkoco.diagnose.lost_commands import sequence as loss_pattern
from deepkoco.diagnose.lost_commands.report import best_losses, deflation_with
from deepkoco.diagnose.lost_commands.search import LostCommands, lost_commands
from deepkoco.diagnose.lost_commands.sequence import Responses, held_over, innovations, offset_of, pattern
from deepkoco.diagnose.residuals.residuals import Dispersion
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.logs.recording import Recording
from deepkoco.systems import make_system
from tests.oracle.excitations import Drive
from tests.oracle.unit import hidden_log

SECONDS, SEED = 12.0, 171
SHORT = 1.003  # of a parameter, over its best value, where a fit has stopped short


def unit(share: float, excitation: str = "chirp") -> Recording:
    return hidden_log("rod_pendulum", {"lost_commands": {"share": share}}, excitation, SEED, SECONDS)


def search(log: Recording):
    base = make_system("rod_pendulum")
    data = cut_data([log], (), base, 1.6)
    start = baseline_from(base, data.train)
    train, reference = refit_sharply(start, data.train)
    return lost_commands(FitProblem(start.system, train), reference, start.prior, 0)


def test_lost_commands_recover_the_share_of_losses():
    found = search(unit(0.08))
    assert 0.04 < found.share < 0.12
    assert found.fit.chi2 / found.problem.windows.samples < 1.1
    assert found.found == found.logs[0].lost.sum()


def test_what_losses_explain_does_not_depend_on_where_the_refit_had_ended():
    """A refit that stopped short leaves what a fit with losses takes up by its parameters."""
    base = make_system("rod_pendulum")
    data = cut_data([unit(0.08)], (), base, 1.6)
    start = baseline_from(base, data.train)
    train, reference = refit_sharply(start, data.train)
    problem, cause = FitProblem(start.system, train), catalogue(base)["lost_commands"]
    short = {n: v * (SHORT if n in reference.free[:1] else 1.0) for n, v in reference.values.items()}
    state, _ = problem.fit_states(short, reference.state)
    stopped = problem.fit([Trial(reference.name, reference.free, start.prior, short, state)], 1)[0]
    assert stopped.cost > reference.cost + 200.0
    found, plain = best_losses(problem, stopped, start.prior, [cause], 1.0, FURTHER)
    wanted, same = best_losses(problem, reference, start.prior, [cause], 1.0, FURTHER)
    assert plain.cost == pytest.approx(reference.cost, abs=1.0)
    assert same.cost == pytest.approx(reference.cost, abs=1.0)
    statistic = [losses.finding.evidence[0].statistic for losses in (found, wanted)]
    assert statistic[0] == pytest.approx(statistic[1], rel=0.02)


@pytest.mark.study
def test_single_loss_joins_the_class_of_a_push():
    """Steps change the command once a second, so only one of all losses shows."""
    only = ["event", "lost_commands", "gain", "lag"]
    lossy = hidden_log("rod_pendulum", {"lost_commands": {"share": 0.03}}, "steps", SEED, 20.0)
    result = diagnose([lossy], "rod_pendulum", only=only)
    assert result.causes[0].members == ("event", "lost_commands")
    assert result.verdict == "ambiguous"
    assert "Number the commands" in result.advice[0]
    pushed = hidden_log(
        "rod_pendulum", {"event": {"torque": 0.5, "start": 7.3, "duration": 0.06}}, "steps", SEED, 20.0
    )
    assert diagnose([pushed], "rod_pendulum", only=only).causes[0].members == ("event",)


@pytest.mark.study
def test_loss_outside_the_push_does_not_join_its_class():
    """The loss, 6 s before the push, lowers the cost about as much as the push."""
    hidden = {
        "lost_commands": {"share": 0.03},
        "event": {"torque": 0.108, "start": 14.3, "duration": 0.06},
    }
    log = hidden_log("rod_pendulum", hidden, "steps", 300, 20.0)
    result = diagnose([log], "rod_pendulum", only=["event", "lost_commands"])
    assert [c.members for c in result.causes] == [("event",)]
    assert result.causes[0].parameters["event.start"].value == pytest.approx(14.3, abs=0.2)


def slow(
    rng, ticks: int, size: float, late: float = 0.0
) -> tuple[Responses, np.ndarray, np.ndarray, np.ndarray]:
    """A mass whose position is seen: responses with no pattern before, commands, lost ticks, and the noise alone."""
    sent = rng.choice([-1.0, 1.0], ticks + 1).cumsum()
    truth = rng.random(ticks) < 0.3
    when = np.arange(float(ticks))
    t = np.linspace(0.0, ticks + 3.0, 8 * ticks)
    since = np.maximum(t[:, None] - late - when, 0.0)
    change = size * (since**2 - np.maximum(since - 1.0, 0.0) ** 2)
    noise, state = rng.standard_normal(len(t)), np.stack([np.ones_like(t), t], 1)
    noise = noise + state @ rng.normal(size=2, scale=30.0)
    responses = innovations(state, change, noise + change @ offset_of(sent, truth), t, when)
    return responses, sent, truth, innovations(state, change, noise, t, when).residual


def cost(responses, sent, lost, price):
    """Of a pattern, with residuals under no loss; a tick whose command changes nothing is never lost."""
    offset = offset_of(sent, lost)
    left = responses.residual - responses.change @ offset
    return left @ left + price * np.count_nonzero(lost & (offset != 0.0))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.1, 0.5, 3.0]), st.floats(0.0, 6.0))
def test_pattern_is_the_best_of_all_patterns(seed, size, price):
    responses, sent, _, _ = slow(np.random.default_rng(seed), 7, size)
    best = min(cost(responses, sent, np.array(lost), price) for lost in product([False, True], repeat=7))
    found = pattern(responses, sent, np.zeros(7, dtype=bool), price, 0.0)
    assert cost(responses, sent, found, price) == pytest.approx(best, abs=1e-6)


@pytest.mark.parametrize(("kept", "sizes"), [(256, (0.1, 0.5, 3.0)), (24, (0.5, 3.0))])
def test_pattern_search_with_few_kept_patterns_finds_the_best(kept, sizes, monkeypatch):
    """Of 4,096; only where a loss hardly shows do so few as 24 not suffice."""
    monkeypatch.setattr(loss_pattern, "KEPT", kept)
    every = np.array(list(product([False, True], repeat=12)))
    for seed in range(30):
        responses, sent, _, _ = slow(np.random.default_rng(seed), 12, sizes[seed % len(sizes)])
        offset = np.array([offset_of(sent, lost) for lost in every])
        left = responses.residual - offset @ responses.change.T
        costs = (left**2).sum(1) + 2.0 * (every & (offset != 0.0)).sum(1)
        found = pattern(responses, sent, np.zeros(12, dtype=bool), 2.0, 0.0)
        assert cost(responses, sent, found, 2.0) == pytest.approx(costs.min(), abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.05, 0.5, 30.0]), st.sampled_from([0.0, 2.5, 8.0]))
def test_pattern_is_never_worse_than_the_previous_one(seed, size, late):
    """Neither with few patterns kept nor where commands act late."""
    responses, sent, truth, noise = slow(np.random.default_rng(seed), 50, size, late)
    wrong = np.random.default_rng(seed + 1).random(50) < 0.3
    for kept in (20, 256):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(loss_pattern, "KEPT", kept)
            for before in (truth, wrong):
                given = responses._replace(
                    residual=responses.residual - responses.change @ offset_of(sent, before)
                )
                found = pattern(given, sent, before, 4.0, 4.0)
                known = cost(responses, sent, before, 0.0) + 4.0 * before.sum()
                assert cost(responses, sent, found, 4.0) <= known + 1e-6
    assert cost(responses, sent, truth, 0.0) == pytest.approx(noise @ noise, rel=1e-4)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 2.5]))
def test_pattern_finds_every_clear_loss(seed, late):
    responses, sent, truth, noise = slow(np.random.default_rng(seed), 60, 30.0, late)
    acted = offset_of(sent, truth)
    # From nothing, and from the truth: then the residuals are what it leaves.
    for before, residual in ((np.zeros(60, dtype=bool), responses.residual), (truth, noise)):
        lost = pattern(responses._replace(residual=residual), sent, before, 4.0, 4.0)
        np.testing.assert_allclose(offset_of(sent, lost)[:-3], acted[:-3])


def test_innovations_accept_a_state_without_effect():
    change, residual, t = np.eye(5), np.arange(1.0, 6.0), np.arange(5.0)
    for state in (np.zeros((5, 2)), np.zeros((5, 0))):
        np.testing.assert_allclose(innovations(state, change, residual, t, t).residual, residual)


def test_innovations_project_out_the_initial_state():
    rng = np.random.default_rng(3)
    t = rng.permutation(np.linspace(0.0, 2.0, 50))
    state, change, residual = rng.normal(size=(50, 2)), rng.normal(size=(50, 4)), rng.normal(size=50)
    responses = innovations(state, change, residual, t, np.array([0.0, 0.5, 1.0, 1.5]))
    assert responses.until.tolist() == [(t < 0.5).sum(), (t < 1.0).sum(), (t < 1.5).sum(), 50]
    offset = rng.normal(size=4)
    left = np.linalg.lstsq(state, residual - change @ offset, rcond=None)[1].item()
    assert ((responses.residual - responses.change @ offset) ** 2).sum() == pytest.approx(left, rel=1e-5)
    # No sample tells of one after it.
    first = np.argsort(t)[:20]
    early = innovations(state[first], change[first], residual[first], t[first], np.zeros(4))
    np.testing.assert_allclose(early.residual, responses.residual[:20], atol=1e-3)


def test_lost_commands_are_none_where_every_command_arrived():
    assert search(unit(0.0)) is None


def test_what_single_ticks_promise_tells_losses_from_noise(monkeypatch):
    promised = []

    def only_promised(self, *_):
        promised.append(self.promised())

    monkeypatch.setattr(search_module._Search, "run", only_promised)
    search(unit(0.0))
    search(unit(0.03))
    assert len(promised) == 1
    assert promised[0] > 100.0


def test_healthy_logs_are_asked_once_of_each_command_that_other_logs_lose():
    asked = []

    def loses(index):
        asked.append(index)
        return index == 1

    losing = LosingCommands(loses)
    assert losing.found == ()
    assert not asked
    assert 1 in losing
    assert 0 not in losing
    assert 1 in losing
    assert asked == [1, 0]
    assert losing.found == (1,)


@pytest.mark.study
def test_lost_commands_are_not_searched_where_healthy_logs_lose_some():
    lossy = {"lost_commands": {"share": 0.08}}
    healthy = hidden_log("rod_pendulum", lossy, "chirp", SEED, SECONDS, take=1)
    result = diagnose([unit(0.08)], "rod_pendulum", healthy=[healthy], only=["lost_commands"])
    assert result.verdict == "nothing"
    assert (
        "the healthy logs also lose some of its commands" in result.unexplained["lost_commands_not_searched"]
    )


@pytest.mark.study
def test_lost_commands_accept_a_log_without_motion():
    hanging = Drive([np.pi], [0.0], lambda t, reading: [0.0])
    still = hidden_log("rod_pendulum", {}, hanging, SEED, SECONDS)
    result = diagnose([still, unit(0.08)], "rod_pendulum", only=["lost_commands"])
    assert result.names == ("lost_commands",)


def test_lost_commands_are_not_searched_at_an_irregular_rate():
    log = unit(0.08)
    sent = log.channels["torque"]
    keep = np.random.default_rng(0).random(len(sent)) < 0.5
    keep[0] = True
    thinned = replace(sent, t=sent.t[keep], value=sent.value[keep])
    assert search(replace(log, channels={**log.channels, "torque": thinned})) is None


@given(st.lists(st.booleans(), min_size=1, max_size=30))
def test_held_over_repeats_the_previous_acting_command(lost):
    sent = np.arange(1.0, len(lost) + 2.0)
    acted = held_over(sent, 1 + np.flatnonzero(lost))
    expected = sent[0]
    for k, gone in enumerate(lost):
        expected = expected if gone else sent[k + 1]
        assert acted[k + 1] == expected


def test_charge_of_lost_commands_is_the_description_length():
    # 5 of 50 ticks: 2,118,760 patterns; one parameter at 1000 samples: log(1000) = 6.9. Of all, there is one pattern.
    windows = SimpleNamespace(samples=1000)
    found = LostCommands(0, (), SimpleNamespace(windows=windows), SimpleNamespace(), 5, 50, 50, 5, 4.0)
    assert found.charge == pytest.approx(2 * np.log(2_118_760) + 6.907755, rel=1e-6)
    assert replace(found, found=50).charge == pytest.approx(6.907755, rel=1e-6)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 60), st.floats(1.0, 20.0), st.floats(0.5, 30.0), st.integers(0, 100_000))
def test_deflation_counts_the_independent_samples_that_positions_use_up(positions, correlation, chi2, seed):
    spread = Dispersion(chi2, correlation, 0.0)
    many = 1e7 * correlation
    assert deflation_with(positions, spread, many) == pytest.approx(spread.deflation, rel=1e-3)
    assert deflation_with(positions, spread, 0.99 * positions * correlation) == math.inf
    # Positions that fit noise of variance 1 leave (1 - positions / independent) of it; the estimate stays 1.
    independent = positions + 2000
    noise = np.random.default_rng(seed).standard_normal(independent)
    noise[:positions] = 0.0
    fitted = Dispersion(float((noise**2).mean()), 1.0, 0.0)
    assert deflation_with(positions, fitted, independent) == pytest.approx(1.0, abs=0.15)


def test_losses_that_use_up_the_independent_samples_are_not_found():
    """A pattern of 54 losses that leaves less than noise in 440 samples, of which 92 are independent."""
    spread = Dispersion(0.64, 4.77, 0.85)
    ratio, charge = 1719.0, 309.0
    assert ratio / spread.deflation - charge > FURTHER
    assert ratio / deflation_with(54, spread, 440) - charge < 0.0
