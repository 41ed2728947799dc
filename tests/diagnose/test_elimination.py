"""A cause that others make superfluous is taken out again; causes that are there stay."""

from deepkoco.diagnose.baseline import refit_sharply, start_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.elimination import eliminated
from deepkoco.diagnose.selection import FURTHER, prior_with
from deepkoco.identify.fit import FitProblem, Trial
from deepkoco.identify.windows import cut_windows, moving, window_length
from deepkoco.systems import make_system
from experiments.hidden.unit import hidden_log


def test_only_the_cause_that_is_not_there_goes():
    hidden = {"asymmetry": {"share": 0.03}, "lag": {"time_constant": 0.01}}
    system = make_system("rod_pendulum")
    windows = cut_windows(
        [hidden_log("rod_pendulum", hidden, "steps", 221, 20.0)], system, window_length(system)
    )
    windows = windows.take(moving(windows))
    start = start_from(system, windows)
    windows, reference = refit_sharply(start, windows)
    problem = FitProblem(start.system, windows)
    known = catalogue(system)
    accepted = [known["torque_bias"], known["lag"], known["asymmetry"]]
    prior = prior_with(problem, start, accepted, start.values)
    fit = problem.fit([Trial("all", prior.names, prior, reference.values, reference.state, reference.zero)])[
        0
    ]
    kept, less = eliminated(problem, start, accepted, fit, FURTHER)
    assert [c.name for c in kept] == ["lag", "asymmetry"]
    assert less.values["torque_bias.effort"] == 0.0
    assert "torque_bias.effort" not in less.free
    assert abs(less.values["lag.time_constant"] - 0.01) < 0.001
    # Both that are there stay, whatever order they were found in.
    assert len(eliminated(problem, start, kept[::-1], less, FURTHER)[0]) == 2
    # However much is wanted, so many stay, and the strongest of them; wherever in the list the others stood.
    assert [c.name for c in eliminated(problem, start, accepted, fit, 1e9)[0]] == ["asymmetry"]
    assert [c.name for c in eliminated(problem, start, accepted[::-1], fit, 1e9)[0]] == ["asymmetry"]
    assert len(eliminated(problem, start, accepted, fit, 1e9, least=2)[0]) == 2
    assert eliminated(problem, start, accepted, fit, 1e9, least=0)[0] == []
