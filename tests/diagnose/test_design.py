"""Design of experiments that distinguish causes."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from deepkoco.cli.command_line import main
from deepkoco.diagnose import diagnose
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.experiment_design import DesignError, InseparableError, design_experiment, write_design
from deepkoco.diagnose.experiment_design import choose as choosing
from deepkoco.diagnose.experiment_design.choose import choose
from deepkoco.diagnose.experiment_design.confirm import confirm
from deepkoco.diagnose.experiment_design.design import chance_of, check_separable, known_causes
from deepkoco.diagnose.experiment_design.design_files import describe
from deepkoco.diagnose.experiment_design.doses import unit_dose
from deepkoco.diagnose.experiment_design.experiment_setup import make_stage
from deepkoco.diagnose.experiment_design.families import FAMILIES, Frame
from deepkoco.diagnose.experiment_design.rehearsal import rehearse
from deepkoco.diagnose.experiment_design.search import judge, scan, sequences
from deepkoco.diagnose.experiment_design.separation import smallest_pair
from deepkoco.systems import ExtendedSystem, load_system, make_system
from deepkoco.systems.bodies.rod_pendulum import RodPendulum
from experiments.studies.diagnosis.hidden.recorded import unit_log

QUICK = {"scanned": 5, "generations": 1, "seconds": 7.0}


def staged(system: str, names: list[str], seconds: float = 7.0, size: float = 1.0, **limits):
    stage = make_stage(make_system(system), seconds, limits or None)
    known = catalogue(make_system(system))
    return stage, [unit_dose(known[n], stage.system).scaled(size, stage.system) for n in names]


@pytest.fixture(scope="module")
def design():
    return design_experiment("rod_pendulum", ["coulomb", "quadratic"], seed=3, **QUICK)


def test_design_has_a_higher_ratio_than_usual_sequences(design):
    assert design.smallest > 24.0
    assert design.settles
    assert design.chance > 0.95
    assert design.worst > max(design.typical.values())


def test_designed_commands_keep_the_limits(design):
    low, high = design.stage.limits.command[0]
    assert low <= design.sequence.min()
    assert design.sequence.max() <= high
    assert all((played.excess == 0.0).all() for played in design.rehearsals)


@pytest.mark.study
def test_design_with_the_same_seed_gives_the_same_sequences():
    stage, doses = staged("rod_pendulum", ["coulomb", "gain"])
    units = [d.on(stage.start.values) for d in doses]
    first, again = (scan(stage, doses, units, np.random.default_rng(4), 2) for _ in range(2))
    assert all(np.array_equal(a.points, b.points) for a, b in zip(first, again, strict=True))
    assert all(np.array_equal(a.cost, b.cost) for a, b in zip(first, again, strict=True))


def test_design_files_contain_the_design_and_the_recorder_plays_them(design, tmp_path):
    commands = write_design(design, tmp_path / "design")
    said = yaml.safe_load((tmp_path / "design" / "design.yaml").read_text())
    assert said["distinguish"] == ["coulomb", "quadratic"]
    assert said["settles"] is True
    assert {p.name for p in commands.parent.iterdir()} == {
        "commands.csv",
        "design.yaml",
        "outcome.csv",
        "outcome.png",
        "sequence.csv",
        "sequence.png",
    }
    unit = tmp_path / "unit.yaml"
    unit.write_text("system: rod_pendulum\nsensor: {rate_hz: 100}\n")
    log = tmp_path / "log.csv"
    status = main(
        ["record", "--unit", str(unit), "--commands", str(commands), "--simulated", "--out", str(log)]
    )
    assert status == 0
    import pandas as pd

    table = pd.read_csv(log)
    sent = table[[c for c in table if "torque" in c]].dropna().to_numpy()[:, -1]
    # The recorder's first command is zero; from then on every command is the one of its time.
    assert sent[1 : len(design.sequence)] == pytest.approx(design.sequence[1:, 0], abs=1e-12)


@pytest.mark.parametrize("pair", [["sensing_delay", "actuation_delay"], ["sensor_bias", "tilt"]])
def test_check_separable_refuses_causes_with_equal_measurements(pair):
    stage, doses = staged("rod_pendulum", pair)
    scans = scan(stage, doses, [d.on(stage.start.values) for d in doses], np.random.default_rng(0), 4)
    with pytest.raises(InseparableError, match="cannot be distinguished by any command") as error:
        check_separable(stage, doses, scans)
    assert set(error.value.pair) == set(pair)
    assert error.value.advice


@pytest.mark.parametrize(
    ("system", "pair"),
    [
        ("pendulum", ["viscous", "quadratic"]),
        pytest.param("two_link_arm", ["coulomb(joint 1)", "viscous(joint 2)"], marks=pytest.mark.study),
        pytest.param("quadrotor_height", ["gain", "quadratic"], marks=pytest.mark.study),
    ],
)
def test_separation_agrees_with_refits_at_small_doses(system, pair):
    stage, doses = staged(system, pair, size=0.2)
    generator = np.random.default_rng(2)
    family = FAMILIES["steps"]
    points = generator.random((1, family.dimension(stage.frame)))
    tried = sequences(stage, family, points)
    ratio, played = confirm(stage, tried[0], doses)
    for a, dose in enumerate(doses):
        first = judge(stage, tried, doses, [dose.on(stage.start.values)])[0].ratio[0]
        assert ratio[a, 1 - a] == pytest.approx(first[a, 1 - a], rel=0.25, abs=0.1)
    assert all(len(p.windows) >= 3 for p in played)


@pytest.mark.study
def test_design_keeps_or_refuses_narrow_limits_of_speed():
    stage, doses = staged("rod_pendulum", ["coulomb", "viscous"], omega=(-2.0, 2.0))
    units = [d.on(stage.start.values) for d in doses]
    scans = scan(stage, doses, units, np.random.default_rng(0), 6)
    assert any(s.allowed.any() for s in scans)
    with pytest.raises(DesignError, match="no sequence keeps the limits"):
        design_experiment(
            "rod_pendulum", ["coulomb", "viscous"], limits={"theta": (0.0, 0.1)}, **{**QUICK, "scanned": 5}
        )


@pytest.fixture
def refits_by_size(monkeypatch):
    """Fake refits whose ratio grows with the size of the sequence; the simulations are real."""

    known = {}

    def confirmed(stage, feedforward, doses):
        key = feedforward.tobytes()
        if key not in known:
            known[key] = [rehearse(stage, feedforward[None], [d.on(stage.start.values)]) for d in doses]
        return np.full((len(doses),) * 2, 100.0 * np.abs(feedforward).max()), known[key]

    monkeypatch.setattr(choosing, "confirm", confirmed)


def pushes(stage, *sizes):
    """Constant commands (K, n, 1), which end at rest."""
    tried = np.repeat(np.array(sizes)[:, None, None], stage.frame.ticks, axis=1)
    tried[:, -1] = 0.0
    return tried


def test_choose_never_takes_a_sequence_that_breaks_a_limit(refits_by_size):
    stage, doses = staged("rod_pendulum", ["coulomb", "gain"], omega=(-1.0, 1.0))
    tried = pushes(stage, 2.0, 0.2, 0.05)
    broken = [choosing.Choice(k, *choosing.confirm(stage, tried[k], doses)).excess > 0.0 for k in range(3)]
    assert broken == [True, False, False]
    for order in [(0, 1, 2), (1, 0, 2), (0, 2, 1), (2, 1, 0)]:
        assert choose(stage, tried, order, doses, 3).index == 1
        # Where too few of those that are asked for keep the limits, further ones are refitted.
        assert choose(stage, tried, order, doses, 1).index == next(k for k in order if k)


def test_choose_names_the_limit_and_the_excess_when_all_sequences_break_one(refits_by_size):
    stage, doses = staged("rod_pendulum", ["coulomb", "gain"], omega=(-1.0, 1.0))
    with pytest.raises(
        DesignError, match=r"brings omega to .* where 1 is allowed, .* % too far; widen .* omega"
    ) as error:
        choose(stage, pushes(stage, 2.0, 1.9), (0, 1), doses, 2)
    played = choosing.confirm(stage, pushes(stage, 1.9)[0], doses)[1]
    assert f"{max(np.abs(p.path[..., 1]).max() for p in played):.4g}" in str(error.value)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["coulomb"], "two or more"),
        (["coulomb", "magic"], 'no cause "magic"'),
        (["coulomb", "jitter"], "scatter"),
        (["coulomb", "event"], "no command sequence can test event"),
    ],
)
def test_known_causes_refuses_causes_that_no_design_can_test(names, message):
    with pytest.raises(DesignError, match=message):
        known_causes(make_system("rod_pendulum"), names)


def test_signals_stay_in_their_range_for_every_family():
    frame = Frame(500, 50.0, 2, 1.6)
    for family in FAMILIES.values():
        points = np.random.default_rng(0).random((9, family.dimension(frame)))
        signals = family.signals(points, frame)
        assert signals.shape == (9, 500, 2)
        assert np.abs(signals).max() <= 1.0
        assert np.ptp(signals, axis=1).min() > 0.0


def test_chance_of_agrees_with_sampled_ratios():
    # N(24, (2 sqrt 24)^2) exceeds 6 with probability Phi(18 / 9.798) = 0.967.
    assert chance_of(24.0) == pytest.approx(0.967, abs=1e-3)
    assert smallest_pair(np.array([[0.0, 3.0], [2.0, 0.0]])) == 2.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--limits", "omega"], "NAME=LOW:HIGH"),
        (["--limits", "torque=-9:9"], "exceed the range of the actuator"),
        (["--limits", "speed=-1:1"], 'has no "speed"'),
        (["--limits", "omega=1:6"], "such as omega=-6:6"),
        (["--limits", "omega=0:6"], "such as omega=-6:6"),
        (["--limits", "omega=-6:-1"], "such as omega=-6:6"),
        (["--limits", "omega=nan:6"], "limits of omega"),
        (["--duration", "1"], "needs several"),
    ],
)
def test_design_command_refuses_wrong_arguments_with_their_reason(arguments, message, tmp_path, capsys):
    base = ["design-experiment", "--system", "rod_pendulum", "--distinguish", "coulomb", "gain"]
    assert main([*base, "--out", str(tmp_path / "out"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_described_design_is_valid_json(design):
    assert json.loads(json.dumps(describe(design), allow_nan=False))["family"] == design.family


def test_described_design_has_null_for_missing_families_and_open_limits(design):
    limits = replace(design.stage.limits, position=np.array([[-np.inf, 3.0]]))
    stage = replace(design.stage, limits=limits)
    said = describe(replace(design, stage=stage, typical={**design.typical, "chirp": float("nan")}))
    said = json.loads(json.dumps(said, allow_nan=False))
    assert said["to_first_order"]["usual_sequences"]["chirp"] is None
    assert said["limits"]["theta"] == [None, 3.0]


class UndefinedAtRest(RodPendulum):
    """A rod with a term that is 0 / 0 where it hangs."""

    def torque_law(self, parameters):
        law = super().torque_law(parameters)

        def torque(theta, omega, effort, smoothing):
            away = theta - np.pi
            return law(theta, omega, effort, smoothing) + 0.0 * away / away

        return torque


class UndefinedBelowRest(RodPendulum):
    """A rod with a term that is not finite just before where it hangs."""

    def torque_law(self, parameters):
        law = super().torque_law(parameters)

        def torque(theta, *rest):
            gap = (theta < np.pi) & (theta > np.pi - 1e-3)
            return law(theta, *rest) + torch.where(gap, torch.nan, 0.0)

        return torque


def test_an_acceleration_that_is_not_finite_at_rest_is_a_design_error():
    with pytest.raises(
        DesignError, match=r"acceleration of joint 1 is not finite at theta = 3.14159, omega = 0"
    ):
        make_stage(UndefinedAtRest(), 8.0)


def test_an_acceleration_that_is_not_finite_beside_rest_is_a_design_error():
    with pytest.raises(
        DesignError, match=r"acceleration of joint 1 is not finite beside .* 1e-06 away in theta"
    ):
        make_stage(UndefinedBelowRest(), 8.0)


def test_too_short_a_log_of_a_system_undefined_at_rest_is_insufficient_and_says_why():
    result = diagnose([unit_log("rod_pendulum", {}, "steps", 71, 2.0)], UndefinedAtRest())
    assert result.verdict == "insufficient"
    assert "Record at least" in result.advice[0]
    assert "is not finite at theta" in result.advice[0]


def test_a_sequence_whose_simulation_diverges_exceeds_all_limits():
    motor = Path(__file__).parents[2] / "docs" / "examples" / "motor.py"
    stiff = ExtendedSystem(load_system(f"{motor}:BeltMotor"), (), {"stiffness": 90.0})
    stage = make_stage(stiff, 4.0)
    assert stage.hold is not None
    commands = np.zeros((2, len(stage.frame.time), 1))
    commands[1] = 6.0
    played = rehearse(stage, commands, [stage.start.values])
    assert played.excess[1] == np.inf
    assert np.isfinite(played.path).all()
    assert np.isfinite(played.commands).all()
    assert bool(torch.isfinite(played.windows.state).all())
