"""A spring at the zero of its joint has no parameter for its centre."""

import math

import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.footholds import trial_of
from deepkoco.diagnose.evidence.natural_shapes import with_natural_shapes
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking, penalty
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion
from deepkoco.fit.data.windows import cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import make_system
from tests.oracle.hysteresis import SYSTEM, hysteresis_log


@pytest.mark.parametrize(("hidden", "sizes"), [("spring_at_zero", 1), ("spring", 2)])
def test_a_spring_pays_for_its_centre_only_where_it_has_one(hidden, sizes):
    system = make_system(SYSTEM)
    windows = cut_windows([hysteresis_log(hidden, 3, 8.0)], system, window_length(system))
    start = baseline_from(system, windows)
    windows, reference = refit_sharply(start, windows.take(moving(windows)))
    problem, spring = FitProblem(start.system, windows), catalogue(system)["spring"]
    at = {**reference.values, "spring.stiffness": 0.2, "spring.centre": 0.1}
    fit = problem.fit([trial_of(problem, start, (), spring, at, reference.state, reference)], 40)[0]
    spread = dispersion(fit, windows)
    samples, places = windows.samples / spread.correlation, SLOTS * len(windows)

    def scored(cause, own):
        ratio = reference.cost - own.cost
        return Candidate(cause, own, ratio, ratio / spread.deflation - penalty(cause, samples, places))

    free = scored(spring, fit)
    ranking = Ranking(reference, (free,), spread, spread.deflation, samples)
    best = with_natural_shapes(problem, start, (), ranking).best
    assert best.cause.name == "spring"
    assert len(best.cause.free) == sizes
    if sizes == 1:
        # One parameter less is ln n; both pay 2 ln 2 for the choice. What a free centre explains is chance.
        lost = (best.fit.cost - fit.cost) / spread.deflation
        assert 0.0 <= lost < 9.0
        assert best.delta_bic - free.delta_bic == pytest.approx(math.log(samples) - lost)
        assert best.fit.values["spring.centre"] == 0.0
        assert best.fit.values["spring.stiffness"] == pytest.approx(0.6, rel=0.05)
    else:
        assert best == free
