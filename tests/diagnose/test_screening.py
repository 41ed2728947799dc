"""Promises of the score test compared with full fits."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.footholds import from_halves
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.screening import Curvature, StartPoint, screen
from deepkoco.fit import Fit, FitProblem, Trial, cut_windows, moving
from deepkoco.systems import make_system
from tests.oracle.hysteresis import hysteresis_log
from tests.oracle.unit import hidden_log


def test_screen_promises_the_fall_of_a_fit_independent_of_other_starts():
    base = make_system("rod_pendulum")
    log = hidden_log("rod_pendulum", {"load_friction": {"coefficient": 0.003}}, "steps", 130, 10.0)
    windows = cut_windows([log], base, 1.6)
    windows = windows.take(moving(windows))
    start = baseline_from(base, windows)
    reference = refit(start, windows)
    problem = FitProblem(start.system, windows)
    known = catalogue(base)
    asked = [(known[n], {}) for n in ("load_friction", "quadratic", "gain_drift")]
    # A lag and a skew change how the efforts of the batch are computed.
    beside = [(known["lag"], {"lag.time_constant": 0.03}), (known["clock_skew"], {}), *asked]
    alone = screen(problem, reference, start.prior, asked)
    together = screen(problem, reference, start.prior, beside)[2:]
    assert [p.promise for p in together] == pytest.approx([p.promise for p in alone], rel=0.05, abs=0.2)
    trials = []
    for cause, _ in asked:
        prior = prior_with(problem, start, [cause], reference.values)
        trials.append(
            Trial(cause.name, prior.names, prior, reference.values, reference.state, reference.nuisance)
        )
    won = [reference.cost - fit.cost for fit in problem.fit(trials, 12)]
    assert np.argmax(won) == np.argmax([p.promise for p in alone])
    assert [p.promise for p in alone] == pytest.approx(won, rel=0.25, abs=1.0)


def test_screen_promises_a_spring_whatever_its_centre():
    """A spring of any centre is linear in its stiffness and in stiffness times centre: two directions."""
    base = make_system("torque_pendulum")
    windows = cut_windows([hysteresis_log("spring", 20003)], base, 1.0)
    start = baseline_from(base, windows)
    reference = refit(start, windows)
    problem, spring = FitProblem(start.system, windows), catalogue(base)["spring"]
    (promised,) = screen(problem, reference, start.prior, [(spring, {"spring.centre": -0.1})])
    prior = prior_with(problem, start, [spring], {**reference.values, "spring.centre": 0.5})
    near = {**reference.values, "spring.stiffness": 0.6, "spring.centre": 0.5}
    fit = problem.fit([Trial("spring", prior.names, prior, near, reference.state, reference.nuisance)])[0]
    assert promised.promise == pytest.approx(reference.cost - fit.cost, rel=0.2)


@pytest.fixture(scope="module")
def weak():
    """Problem, baseline and refit of a rod whose drive has lost half its strength, and the start of that cause."""
    base = make_system("rod_pendulum")
    windows = cut_windows(
        [hidden_log("rod_pendulum", {"gain": {"factor": 0.5}}, "steps", 20004, 10.0)], base, 1.6
    )
    windows = windows.take(moving(windows))
    start = baseline_from(base, windows)
    reference = refit(start, windows)
    problem = FitProblem(start.system, windows)
    given = {**reference.values, **{n: start.values[n] for n in start.prior.names}}
    return problem, start, reference, StartPoint(catalogue(base)["gain"], {}, 1.0), given


def test_starts_from_half_windows_are_near_the_true_size_although_the_refit_is_far_away(weak):
    problem, start, reference, point, given = weak
    (trial,) = from_halves(problem, start, (), [point], [given], reference)
    assert trial.values["gain.factor"] == pytest.approx(0.5, abs=0.03)
    # Initial states of whole windows, at which the simulation follows the log.
    assert trial.state is not None
    assert trial.state.shape == reference.state.shape
    fit = problem.fit([trial], 1)[0]
    assert fit.chi2 < 1.1 * problem.windows.samples
    assert reference.cost > 3.0 * fit.cost


def test_starts_from_half_windows_are_kept_where_the_refit_diverges_in_them(weak):
    problem, start, reference, point, given = weak
    lost = replace(reference, values={**reference.values, "quadratic.drag": -5.0})
    assert "quadratic.drag" in reference.values
    assert [t.name for t in from_halves(problem, start, (), [point], [given], lost)] == ["gain"]


@pytest.mark.parametrize(("promised", "stuck"), [(0.5, True), (0.01, False), (0.0, False)])
def test_a_fit_is_stuck_where_a_step_still_promises_much(promised, stuck):
    none = np.zeros((0, 0))
    empty = torch.zeros(0)
    fit = Fit("", (), {}, none, none, empty, empty, 4.0, 0.0, empty, promised=promised)
    assert fit.stuck == stuck


def test_what_rounding_leaves_of_a_curvature_takes_no_more_out_of_a_dose_than_is_in_it():
    """The difference of two parameters has a curvature of 1e-12 of that of their sum, where rounding left 1e-13."""
    matrix = torch.tensor([[1.0, 1.0 - 1e-13], [1.0 - 1e-13, 1.0]], dtype=torch.float64)
    dose = torch.tensor([[1.0 + 1e-6, 1.0 - 1e-6]], dtype=torch.float64)
    right = torch.zeros(2, dtype=torch.float64)
    gram, pull = torch.tensor([[4.0]], dtype=torch.float64), torch.tensor([2.0], dtype=torch.float64)
    # The sum takes 1 out of 4; the difference would take 2 * (1e-6)^2 / 1e-13 = 20 more.
    left, rest = Curvature(matrix, right).without(gram, dose, pull)
    assert float(left) == pytest.approx(3.0, abs=0.05)
    assert float(rest) == 2.0
    # A curvature that is known well is inverted as it is.
    left, _ = Curvature(2.0 * torch.eye(2, dtype=torch.float64), right).without(gram, dose, pull)
    assert float(left) == pytest.approx(3.0)
