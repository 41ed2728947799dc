"""A simpler form of a cause is compared from the same optimum of the other parameters."""

from dataclasses import replace

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.footholds import trial_of
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking, penalty
from deepkoco.diagnose.evidence.refine_ranking import front_settled
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion
from deepkoco.fit.data.windows import cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import make_system
from experiments.studies.diagnosis.hidden.recorded import unit_log


def test_dry_friction_that_ended_in_another_minimum_is_not_called_stribeck():
    system = make_system("rod_pendulum")
    log = unit_log("rod_pendulum", {"coulomb": {"torque": 0.3}}, "steps", 5, 10.0)
    windows = cut_windows([log], system, window_length(system))
    start = baseline_from(system, windows)
    windows, reference = refit_sharply(start, windows.take(moving(windows)))
    problem, known = FitProblem(start.system, windows), catalogue(system)
    values = {**reference.values, "coulomb.torque": 0.2, "stribeck.coulomb": 0.2, "stribeck.breakaway": 0.02}
    null = {n: start.values[n] for n in values if n.startswith(("coulomb.", "stribeck."))}
    fits = {}
    for name in ("coulomb", "stribeck"):
        own = {n: values[n] for n in known[name].free if n in values}
        at = {**reference.values, **null, **own}
        trial = trial_of(problem, start, (), known[name], at, reference.state, reference)
        fits[name] = problem.fit([trial], 40)[0]
    # A fit that stopped at other lengths and masses, and believes that it has converged.
    lost = 0.5 * (reference.cost - fits["coulomb"].cost)
    elsewhere = {n: 1.05 * fits["coulomb"].values[n] for n in start.prior.names}
    bad = replace(
        fits["coulomb"],
        values={**fits["coulomb"].values, **elsewhere},
        chi2=fits["coulomb"].chi2 + lost,
        converged=True,
    )
    spread = dispersion(fits["stribeck"], windows)
    samples = windows.samples / spread.correlation
    candidates = []
    for name, fit in (("stribeck", fits["stribeck"]), ("coulomb", bad)):
        ratio = reference.cost - fit.cost
        score = ratio / spread.deflation - penalty(known[name], samples, SLOTS * len(windows))
        candidates.append(Candidate(known[name], fit, ratio, score))
    assert candidates[0].delta_bic > candidates[1].delta_bic + 24.0
    ranking = Ranking(reference, tuple(candidates), spread, spread.deflation, samples)
    # Small effects of healthy logs need no name.
    assert front_settled(problem, start, (), ranking, forms=False).best.cause.name == "stribeck"
    found = front_settled(problem, start, (), ranking)
    assert found.best.cause.name == "coulomb"
    assert abs(found.best.fit.cost - fits["coulomb"].cost) < 1.0
