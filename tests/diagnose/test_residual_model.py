"""A learned load for effects outside of the catalogue."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.evidence import residual_model, term_choice
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.data.windows import cut_windows, estimate_channels, window_length
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import ExtendedSystem, load_model, make_system, rk4_step, save_model
from deepkoco.systems.effects.learned import SCALES, terms_at
from tests.oracle.slide import Car, Unit, log_of
from tests.oracle.unit import hidden_log

HIDDEN = {"position_friction": {"size": 0.1}}  # no cause of the catalogue
FEW = ["gain", "lag"]


@pytest.fixture(scope="module")
def diagnosis():
    return diagnose([hidden_log("rod_pendulum", HIDDEN, "steps", 5, 16.0)], "rod_pendulum", only=FEW)


@pytest.mark.study
def test_learned_load_lowers_the_held_out_error_of_an_unknown_effect(diagnosis):
    assert diagnosis.verdict == "unknown"
    learned = diagnosis.unexplained["residual_model"]
    assert learned["accepted"]
    assert learned["low"] > 0.2
    # Down to the noise of the sensors.
    assert learned["chi2_per_sample_before"] > 2.0
    assert learned["chi2_per_sample_after"] < 1.05
    assert diagnosis.chi2_after == pytest.approx(learned["chi2_per_sample_after"])
    assert diagnosis.strength == pytest.approx((diagnosis.chi2_before - diagnosis.chi2_after) ** 0.5)
    # The friction is -size (1 + cos q) v: its share with cos q is what the baseline has no word for.
    weights = {term["name"]: term["weight"] for term in learned["terms"]}
    scale = diagnosis.model.parameter("learned.speed_scale").value
    assert set(weights) <= {"learned.v", "learned.v_cos"}
    assert weights["learned.v_cos"] / scale == pytest.approx(-0.1, rel=0.15)


@pytest.mark.study
def test_model_file_is_marked_and_round_trips(diagnosis, tmp_path):
    path = tmp_path / "model.yaml"
    save_model(path, diagnosis.model)
    assert yaml.safe_load(path.read_text())["learned"] == ["learned"]
    back = load_model(path)
    assert {p.name: p.value for p in back.parameters} == {p.name: p.value for p in diagnosis.model.parameters}
    state, effort = torch.tensor([2.0, 3.0], dtype=torch.float64), torch.tensor(0.5, dtype=torch.float64)
    stepped = [rk4_step(m, state, effort, 0.01, m.default_parameters()) for m in (back, diagnosis.model)]
    assert torch.equal(*stepped)


@pytest.mark.study
def test_diagnose_from_a_learned_model_finds_nothing_on_another_excitation(diagnosis):
    log = hidden_log("rod_pendulum", HIDDEN, "chirp", 5, 12.0)
    again = diagnose([log], diagnosis.model, only=FEW)
    assert again.verdict == "nothing"


@pytest.mark.study
def test_learned_weights_of_a_model_file_keep_scales_and_prior(monkeypatch):
    monkeypatch.setattr(term_choice, "MOST_TERMS", 2)
    had = {"learned.v_cubed": 0.4, "learned.speed_scale": 5.0, "learned.effort_scale": 3.0}
    system = ExtendedSystem(make_system("rod_pendulum"), ("learned",), had)
    log = hidden_log("rod_pendulum", HIDDEN, "steps", 5, 10.0)
    windows = cut_windows([log], system, window_length(system), estimate_channels([log], system))
    start = baseline_from(system, windows)
    reference = refit(start, windows)
    missing = missing_torque(FitProblem(start.system, windows), reference)
    learned = residual_model.learn_residual(start, windows, None, reference, missing, 0)
    assert learned is not None
    assert learned.terms
    # Springs had no weight yet, so their places are those of these data.
    low, high = missing[0].theta.min(), missing[0].theta.max()
    assert learned.fit.values["learned.angle_middle"] == pytest.approx(0.5 * (low + high))
    assert learned.fit.values["learned.angle_scale"] == pytest.approx(0.5 * (high - low))
    # It was free already: a second time would give its prior twice the variance.
    assert "learned.v_cubed" not in [term.name for term in learned.terms]
    assert "learned.v_cubed" in learned.fit.free
    assert {name: learned.fit.values[name] for name in had if name.endswith("scale")} == {
        name: value for name, value in had.items() if name.endswith("scale")
    }


@pytest.mark.study
def test_learn_residual_offers_no_spring_where_a_joint_rests():
    log = hidden_log("rod_pendulum", HIDDEN, "steps", 5, 10.0)
    windows = cut_windows([log], make_system("rod_pendulum"), 1.6)
    start = baseline_from(make_system("rod_pendulum"), windows)
    missing = missing_torque(FitProblem(start.system, windows), refit(start, windows))
    assert residual_model._resting(windows, missing) == ()
    still = [replace(m, theta=np.full_like(m.theta, 3.0)) for m in missing]
    assert residual_model._resting(windows, still) == (0,)


def test_null_weights_recover_the_baseline():
    for name in ("rod_pendulum", "two_link_arm", "quadrotor_height"):
        base = make_system(name)
        effects = ("learned",) if base.joints == 1 else ("learned(joint 1)", "learned(joint 2)")
        extended = ExtendedSystem(base, effects)
        generator = torch.Generator().manual_seed(0)
        state = torch.randn(7, 2 * base.joints, generator=generator, dtype=torch.float64)
        commands = torch.randn(7, len(base.commands), generator=generator, dtype=torch.float64)
        effort = base.effort_of(commands)
        plain = base.derivative(state, effort, base.default_parameters())
        assert torch.equal(extended.derivative(state, effort, extended.default_parameters()), plain)


def test_every_term_acts_where_it_is_declared():
    base = make_system("rod_pendulum")
    # On either side of the middle, where springs begin.
    state = torch.tensor([[1.0, 0.7], [-1.0, 0.7]], dtype=torch.float64)
    effort = torch.tensor(0.5, dtype=torch.float64)
    plain = base.derivative(state, effort, base.default_parameters())
    for term in terms_at(base, 0):
        moved = ExtendedSystem(base, ("learned",), {f"learned.{term}": 0.3})
        assert not torch.equal(moved.derivative(state, effort, moved.default_parameters()), plain)
    assert not any(s in terms_at(base, 0) for s in SCALES)


@pytest.mark.study
def test_learn_residual_rejects_a_random_load():
    log = hidden_log("rod_pendulum", {"turbulence": {"size": 0.05}}, "steps", 6, 16.0)
    result = diagnose([log], "rod_pendulum", only=["gain"])
    assert result.verdict == "unknown"
    learned = result.unexplained["residual_model"]
    assert not learned["accepted"]
    assert [e.name for e in result.model.effects] == []


@pytest.mark.study
def test_learn_residual_finds_a_spring_that_begins_at_an_angle():
    """A tether that is slack up to 0.15 rad from the start: no cause of the catalogue."""
    log = hidden_log("rod_pendulum", {"tether": {"stiffness": 0.5}}, "steps", 5, 20.0)
    result = diagnose([log], "rod_pendulum", only=FEW)
    assert result.verdict == "unknown"
    learned = result.unexplained["residual_model"]
    assert learned["accepted"]
    assert learned["chi2_per_sample_before"] > 2.0
    assert learned["chi2_per_sample_after"] < 1.05
    first = learned["terms"][0]
    assert first["name"] == "learned.beyond_15"
    assert first["weight"] / result.model.parameter("learned.angle_scale").value == pytest.approx(
        -0.5, rel=0.2
    )


def test_learned_springs_begin_at_the_angles_of_their_names():
    base = make_system("rod_pendulum")
    values = {"learned.angle_middle": 3.0, "learned.angle_scale": 2.0}
    state = torch.tensor([[3.0 + 2.0 * z, 0.0] for z in (-0.8, -0.1, 0.3, 0.9)], dtype=torch.float64)
    effort = torch.zeros(4, dtype=torch.float64)

    def load(term):
        systems = [ExtendedSystem(base, ("learned",), {**values, f"learned.{term}": w}) for w in (0.0, 1.0)]
        less, more = (s.derivative(state, effort, s.default_parameters())[:, 1] for s in systems)
        return (more - less) / (more - less).abs().max()

    torch.testing.assert_close(load("above_p15") * 0.75, torch.tensor([0.0, 0.0, 0.15, 0.75]).double())
    torch.testing.assert_close(load("below_m40") * 0.4, torch.tensor([-0.4, 0.0, 0.0, 0.0]).double())
    torch.testing.assert_close(load("beyond_70") * 0.2, torch.tensor([-0.1, 0.0, 0.0, 0.2]).double())


@pytest.mark.study
def test_learned_load_finds_two_forces_of_which_the_larger_alone_looks_like_another():
    # Alone, a friction that grows with the effort or the speed explains more than dry friction does.
    log = log_of(Unit(110.0, 180.0, 18.0, offset=3.0), 20_300)
    found = diagnose([log], Car(), only=["periodic", "asymmetry"], window=1.5)
    assert found.verdict == "unknown"
    terms = {term["name"]: term["weight"] for term in found.unexplained["residual_model"]["terms"]}
    assert terms["learned.sign_v"] == pytest.approx(-18.0, rel=0.05)
    assert found.gain is not None
    held = found.gain.channels[0]
    assert held.extended < 0.05 * held.refit
