"""Fits that begin on the shortest windows where those of the windows themselves find no minimum."""

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.shorter_first import FEWEST, FOLLOWED, shorter_first
from deepkoco.fit import FitProblem, Trial, cut_windows, moving
from deepkoco.fit.fit import ITERATIONS
from deepkoco.fit.solve.levenberg_marquardt import TOLERANCE
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log


@pytest.fixture(scope="module")
def arm():
    """Windows of an arm that swings, its baseline, and the minimum that the values given lead to."""
    base = make_system("two_link_arm")
    windows = cut_windows([hidden_log("two_link_arm", {}, "steps", 1, 10.0)], base, 1.6)
    windows = windows.take(moving(windows))
    start = baseline_from(base, windows)
    least = shorter_first(start.system, start.values, start.prior, start.prior.names, windows)
    assert least.converged
    return windows, start, least


def far_values(windows, start, seed, spread=0.8):
    problem, rng = FitProblem(start.system, windows), np.random.default_rng(seed)
    far = dict(start.values)
    for name in start.prior.names:
        i = problem.names.index(name)
        low, high = problem.low[i], problem.high[i]
        far[name] = float(np.clip(far[name] * np.exp(rng.normal(0.0, spread)), low, high))
    return far


def spied(monkeypatch):
    """Windows of every fit from now on, in turn."""
    fitted, fit = [], FitProblem.fit
    monkeypatch.setattr(
        FitProblem, "fit", lambda self, *a, **k: fitted.append(self.windows) or fit(self, *a, **k)
    )
    return fitted


@pytest.mark.parametrize("seed", [3, 13])
def test_short_windows_lead_to_the_minimum_that_long_ones_miss(arm, seed, monkeypatch):
    windows, start, least = arm
    far, fitted = far_values(windows, start, seed), spied(monkeypatch)
    problem = FitProblem(start.system, windows)
    state, _ = problem.fit_states(far, windows.state)
    alone = problem.fit([Trial("alone", start.prior.names, start.prior, far, state)], ITERATIONS)[0]
    assert alone.cost > least.cost + 100.0
    fitted.clear()
    found = shorter_first(start.system, far, start.prior, start.prior.names, windows)
    assert found.cost == pytest.approx(least.cost, rel=0.0, abs=TOLERANCE)
    lengths = [w.length for w in fitted]
    assert lengths[0] == lengths[-1] == windows.length
    assert lengths[1:] == sorted(lengths[1:])
    assert lengths[1] < 0.25 * windows.length


@pytest.mark.parametrize("rounding", [0, 1, 2])
def test_shortest_windows_that_find_no_minimum_begin_nearer_to_the_prior(arm, rounding, monkeypatch):
    windows, start, least = arm
    far, rng = far_values(windows, start, 13), np.random.default_rng(rounding)
    far |= {n: far[n] * (1.0 + 1e-12 * rng.normal()) for n in start.prior.names}
    fitted = spied(monkeypatch)
    found = shorter_first(start.system, far, start.prior, start.prior.names, windows)
    assert found.cost == pytest.approx(least.cost, rel=0.0, abs=TOLERANCE)
    lengths = [w.length for w in fitted]
    assert min(lengths) < 0.25 * windows.length
    assert lengths.count(min(lengths)) == 2


def test_a_fit_that_finds_a_minimum_needs_no_shorter_windows(arm, monkeypatch):
    windows, start, _ = arm
    fitted = spied(monkeypatch)
    shorter_first(start.system, start.values, start.prior, start.prior.names, windows)
    assert [w.length for w in fitted] == [windows.length]


def test_a_fit_that_begins_near_may_end_before_its_minimum(arm, monkeypatch):
    windows, start, least = arm
    near = {**start.values, **{n: 1.001 * least.values[n] for n in start.prior.names}}
    fitted = spied(monkeypatch)
    found = shorter_first(start.system, near, start.prior, start.prior.names, windows, 2, begun=True)
    assert not found.converged
    assert [w.length for w in fitted] == [windows.length]


def test_a_fit_that_follows_its_windows_closely_goes_on_first(arm, monkeypatch):
    windows, start, least = arm
    far, fitted = far_values(windows, start, 6), spied(monkeypatch)
    found = shorter_first(start.system, far, start.prior, start.prior.names, windows)
    assert [w.length for w in fitted] == 2 * [windows.length]
    assert found.chi2 < FOLLOWED * windows.samples
    assert found.cost == pytest.approx(least.cost, rel=0.0, abs=TOLERANCE)


def test_a_fit_that_does_not_come_near_needs_shorter_windows_wherever_it_begins(arm):
    windows, start, least = arm
    far, names = far_values(windows, start, 3), start.prior.names
    found = shorter_first(start.system, far, start.prior, names, windows, begun=True)
    assert found.cost == pytest.approx(least.cost, rel=0.0, abs=TOLERANCE)


def test_windows_become_no_shorter_than_shows_a_motion(arm, monkeypatch):
    windows, start, _ = arm
    fitted = spied(monkeypatch)
    shorter_first(start.system, far_values(windows, start, 3), start.prior, start.prior.names, windows, 2)
    assert min(int(w.valid.sum(-1).min()) for w in fitted) >= FEWEST - 1
