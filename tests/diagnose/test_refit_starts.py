"""Starts of the refit: a fit that ends without a minimum does not stand."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import on_half_windows, refit
from deepkoco.fit import FitProblem, cut_windows, moving
from deepkoco.fit.solve.levenberg_marquardt import TOLERANCE
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log


@pytest.mark.parametrize("nudge", [0.0, 1e-9])
def test_a_refit_that_is_stuck_starts_again_from_the_values_given(nudge):
    base = make_system("two_link_arm")
    windows = cut_windows([hidden_log("two_link_arm", {}, "steps", 1, 10.0)], base, 1.6)
    windows = windows.take(moving(windows))
    start = baseline_from(base, windows)
    first = on_half_windows(start, windows, start.prior.names)
    problem, rng = FitProblem(start.system, windows), np.random.default_rng(3)
    far = dict(first.values)
    for name in start.prior.names:
        i = problem.names.index(name)
        far[name] *= (1.0 + nudge) * float(np.exp(rng.normal(0.0, 0.8)))
        far[name] = float(np.clip(far[name], problem.low[i], problem.high[i]))
    found = refit(start, windows, first=replace(first, values=far))
    assert found.converged
    assert found.cost == pytest.approx(refit(start, windows, first=first).cost, rel=0.0, abs=TOLERANCE)
