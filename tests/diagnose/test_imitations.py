"""Flexible causes (lost commands, detents, tones, pushes) are not named where they only imitate another cause."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import CAUSES, catalogue
from deepkoco.diagnose.causes.cause import Hint
from deepkoco.diagnose.evidence.elimination import carried
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.healthy import learn_baseline
from deepkoco.fit.data.windows import cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.systems import make_system
from experiments.studies.diagnosis.hidden.cases import small_effects
from tests.oracle.unit import hidden_log

TETHER = {"tether": {"stiffness": 0.235}}


@pytest.mark.study
def test_lost_commands_are_not_named_for_a_tether():
    """Losses at hundreds of ticks can fit a tether, but the positions of these losses depend on the motion."""
    log = hidden_log("rod_pendulum", TETHER, "closed-loop", 2037)
    result = diagnose([log], "rod_pendulum", only=["lost_commands"])
    assert result.chi2_before > 1.3
    assert result.verdict == "unknown"
    assert result.candidates == ()


@pytest.mark.study
def test_detents_and_pushes_are_not_named_for_a_tether():
    """A learned load explains as much as detents; detents together with a push leave more than noise."""
    for stiffness, seed, doubt in (
        (0.204, 2791, "explains the log nearly as well as cogging"),
        (0.235, 2037, "With cogging and event, more than noise remains"),
    ):
        log = hidden_log("rod_pendulum", {"tether": {"stiffness": stiffness}}, "closed-loop", seed)
        result = diagnose([log], "rod_pendulum", only=["cogging", "event"])
        assert result.candidates[0].delta_bic > 24.0
        assert result.verdict == "unknown"
        assert result.unexplained["residual_model"]["accepted"]
        assert doubt in result.unexplained["doubts"][0]


@pytest.mark.study
def test_lost_commands_are_not_named_for_two_other_causes():
    hidden = {"actuation_delay": {"delay": 0.003}, "quadratic": {"drag": 0.0015}}
    log = hidden_log("rod_pendulum", hidden, "chirp", 2025)
    result = diagnose([log], "rod_pendulum", only=["actuation_delay", "quadratic", "lost_commands"])
    assert sorted(result.names) == ["actuation_delay", "quadratic"]


@pytest.mark.study
def test_lost_commands_are_named_together_with_friction():
    hidden = {"coulomb": {"torque": 0.03}, "lost_commands": {"share": 0.05}}
    log = hidden_log("rod_pendulum", hidden, "chirp", 207)
    result = diagnose([log], "rod_pendulum", only=["coulomb", "lost_commands", "quadratic"])
    assert sorted(result.names) == ["coulomb", "lost_commands"]
    share = result.causes[-1].parameters["lost_commands.share"]
    assert 0.02 < share.value < 0.08


@pytest.mark.study
def test_lost_commands_that_fit_a_small_error_take_no_name_away():
    """They explain 1 and 4 % of what friction explains, and leave more than noise: a gain that drifts is not tried."""
    for torque, drift, seed in ((0.3, 0.005, 1), (0.2, 0.005, 2)):
        hidden = {"coulomb": {"torque": torque}, "gain_drift": {"rate": drift}}
        log = hidden_log("rod_pendulum", hidden, "closed-loop", seed, 10.0)
        result = diagnose([log], "rod_pendulum", only=["coulomb", "lost_commands"])
        assert result.names == ("coulomb",)
        assert result.causes[0].parameters["coulomb.torque"].value == pytest.approx(torque, rel=0.06)


@pytest.mark.parametrize(("turned", "fewest"), [(2.0, 7), (0.5, 26), (0.3, None), (20.0, 2)])
def test_cogging_starts_need_two_cycles_in_the_log(turned, fewest):
    # The second log counts its turns from elsewhere.
    theta = np.array([[0.0, 0.4 * turned], [0.1, turned], [6.3, 6.4]])
    missing = SimpleNamespace(theta=theta, log=np.array([0, 0, 1]))
    nothing = np.zeros(0)
    hint = Hint(make_system("rod_pendulum"), 0, nothing, nothing, (), 30.0, 1.0, missing)
    tried = [place["cycles"] for place in CAUSES["cogging"].starts(hint)]
    assert tried == ([] if fewest is None else [float(n) for n in range(fewest, 31)])


@pytest.mark.study
def test_carried_removes_a_cause_that_raises_the_held_out_error():
    system = make_system("rod_pendulum")
    log = hidden_log("rod_pendulum", {"coulomb": {"torque": 0.1}}, "steps", 223, 24.0)
    windows = cut_windows([log], system, window_length(system))
    windows = windows.take(moving(windows))
    first = np.arange(len(windows)) < len(windows) // 2
    train, held = windows.take(first), windows.take(~first)
    start = baseline_from(system, train)
    train, reference = refit_sharply(start, train)
    problem, known = FitProblem(start.system, train), catalogue(system)
    accepted = [known["coulomb"], known["sensor_drift"]]
    prior = prior_with(problem, start, accepted, start.values)
    fit = problem.fit(
        [Trial("both", prior.names, prior, reference.values, reference.state, reference.nuisance)]
    )
    # A drift that is not there: it grows where nothing was fitted.
    drifting = {**fit[0].values, "sensor_drift.rate": 0.002}
    wrong = problem.fit(
        [Trial("wrong", ("coulomb.torque",), prior, drifting, fit[0].state, fit[0].nuisance)],
    )[0]
    kept, less = carried(problem, start, accepted, wrong, held, 1)
    assert [c.name for c in kept] == ["coulomb"]
    assert less.values["sensor_drift.rate"] == 0.0
    # Beside a push it need not stay for being the only cause that lasts.
    pushed = [known["event"], known["sensor_drift"]]
    assert [c.name for c in carried(problem, start, pushed, wrong, held, 1)[0]] == ["event"]
    # The one that is there stays, even where none has to.
    assert [c.name for c in carried(problem, start, kept, less, held, 0)[0]] == ["coulomb"]


@pytest.mark.study
def test_learn_baseline_finds_small_effects_without_a_mixture():
    system = make_system("rod_pendulum")
    floor = small_effects("rod_pendulum")
    start = learn_baseline([hidden_log("rod_pendulum", floor, "chirp", 1020)], system, window_length(system))
    assert start.floor < 1.06
    # Each by its own name or by those that the log does not tell from it; nothing else.
    alike = [
        {"lag", "low_pass", "actuation_delay", "sensing_delay"},
        {"load_friction"},
        # A weak spring that rests far away is a constant torque. So is friction that differs by direction, in a swing.
        {"torque_bias", "asymmetry", "asymmetric_viscous", "spring"},
        {"gain_drift"},
    ]
    assert set(start.effects) <= set().union(*alike)
    assert all(group & set(start.effects) for group in alike)
    held_back = sum(v for n, v in start.values.items() if n.split(".")[0] in alike[0])
    assert held_back == pytest.approx(floor["lag"]["time_constant"], rel=0.2)
    assert start.values["torque_bias.effort"] == pytest.approx(floor["torque_bias"]["effort"], rel=0.2)
    share = start.values["load_friction.coefficient"]
    assert share == pytest.approx(floor["load_friction"]["coefficient"], rel=0.2)
    rate = start.values["gain_drift.rate"]
    assert rate == pytest.approx(floor["gain_drift"]["rate"], rel=0.2)


@pytest.mark.study
def test_saturation_and_gain_share_a_class_under_two_level_commands():
    """With two levels the limit cuts every command, so the fit must reach a low limit from a start just below them."""
    log = hidden_log("rod_pendulum", {"saturation": {"limit": 1.6}}, "bang-bang", 227, 16.0)
    found = diagnose([log], "rod_pendulum", only=["saturation", "gain", "payload", "lag"])
    assert found.verdict == "cause"
    assert set(found.causes[0].members) == {"saturation", "gain"}
