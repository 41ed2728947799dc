"""Diagnoses of robots that are not in the package, from the command line, with logs of independent simulations."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from deepkoco.cli.command_line import main
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.verdict.advice import naming
from deepkoco.systems import ExtendedSystem, load_system, make_system
from tests.oracle.own_robots import CartPoleUnit, MotorUnit

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
CART, MOTOR = f"{EXAMPLES}/cart_pole.py:CartPole", f"{EXAMPLES}/motor.py:Motor"
BELT = f"{EXAMPLES}/motor.py:BeltMotor"


def diagnosed(folder: Path, unit: CartPoleUnit | MotorUnit, system: str, seconds: float) -> dict[str, Any]:
    """The report of a log of a unit."""
    log = unit.log(folder, seconds=seconds)
    assert main(["diagnose", str(log), "--system", system, "--out", str(folder / "report")]) == 0
    return json.loads((folder / "report" / "report.json").read_text())


@pytest.mark.parametrize(
    ("unit", "system"),
    [
        pytest.param(CartPoleUnit(), CART, id="cart-pole", marks=pytest.mark.study),
        pytest.param(MotorUnit(), MOTOR, id="motor", marks=pytest.mark.study),
    ],
)
def test_a_healthy_robot_of_ones_own_misses_nothing(tmp_path, unit, system):
    assert diagnosed(tmp_path, unit, system, 10.0)["verdict"] == "nothing"


@pytest.mark.study
@pytest.mark.long
def test_the_delay_of_a_motor_of_ones_own_is_named_with_its_size(tmp_path):
    assert diagnosed(tmp_path, MotorUnit(delay=0.03), MOTOR, 10.0)["verdict"] == "cause"
    model = load_system(tmp_path / "report" / "model.yaml")
    assert model.parameter("actuation_delay.delay").value == pytest.approx(0.03, abs=5e-4)


@pytest.mark.study
def test_only_the_sum_of_two_inertias_of_a_motor_is_told(tmp_path):
    report = diagnosed(tmp_path, MotorUnit(load_inertia=2.2e-4), MOTOR, 10.0)
    assert report["verdict"] == "nothing"
    (moved,) = report["fit"]["moved"]
    assert (moved["name"], moved["sum_with"]) == ("load_inertia", ["motor_inertia"])
    assert moved["sum_given"] == pytest.approx(2e-4)
    assert moved["value"] == pytest.approx(2.2e-4, rel=0.01)
    assert (
        "only the sum of load inertia and motor inertia" in (tmp_path / "report" / "report.html").read_text()
    )


@pytest.mark.study
def test_of_parameters_that_a_log_cannot_tell_apart_the_least_known_one_leads(tmp_path):
    # Another resistance slows the motor just as a larger load does, but it is known to 2 %, and the load to 20 %.
    report = diagnosed(tmp_path, MotorUnit(load_inertia=3e-4), MOTOR, 20.0)
    (cause,) = report["causes"]
    assert cause["name"] == "changed(load_inertia)"
    assert cause["parameters"]["load_inertia"]["value"] == pytest.approx(3e-4, rel=0.05)


def test_advised_commands_name_a_robot_by_its_file(tmp_path, monkeypatch):
    # Nobody has registered its name.
    shutil.copy(EXAMPLES / "cart_pole.py", tmp_path / "mine.py")
    monkeypatch.chdir(tmp_path)
    option, value = naming(load_system("mine.py:CartPole"))
    assert (option, value) == ("--system", "mine.py:CartPole")
    assert naming(make_system("rod_pendulum")) == ["--system", "rod_pendulum"]


def test_only_a_joint_without_a_motor_may_have_a_constant_load():
    # On a driven joint it is a bias of the effort.
    names = catalogue(load_system(CART)).keys()
    assert "constant_load(pole)" in names
    assert "constant_load(cart)" not in names
    assert "torque_bias(cart)" in names


STUDY = {
    "cart-pole, delay": (CartPoleUnit(delay=0.03), CART, "actuation_delay(cart).delay", 0.03, 5e-4),
    "cart-pole, dry friction": (CartPoleUnit(coulomb=0.7), CART, "coulomb(cart).torque", 0.7, 0.02),
    "cart-pole, wind": (CartPoleUnit(pull=0.03), CART, "constant_load(pole).load", 0.03, 1e-3),
    "motor, dry friction": (MotorUnit(coulomb=0.02), MOTOR, "coulomb.torque", 0.02, 0.003),
}


@pytest.mark.study
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=pytest.mark.long) if c != "cart-pole, delay" else c for c in STUDY]
)
def test_a_hidden_effect_of_a_robot_of_ones_own_is_named_with_its_size(tmp_path, case):
    unit, system, parameter, truth, tolerance = STUDY[case]
    assert diagnosed(tmp_path, unit, system, 20.0)["verdict"] == "cause"
    model = load_system(tmp_path / "report" / "model.yaml")
    assert isinstance(model, ExtendedSystem)
    assert [e.name for e in model.effects] == [parameter.split(".")[0]]
    assert model.parameter(parameter).value == pytest.approx(truth, abs=tolerance)


@pytest.mark.study
@pytest.mark.long
@pytest.mark.timeout(1800)
def test_an_elastic_belt_is_what_a_stiff_model_lacks_and_nothing_to_an_elastic_one(tmp_path):
    for name, system, causes in (("stiff", MOTOR, ["elastic"]), ("elastic", BELT, [])):
        (tmp_path / name).mkdir()
        found = diagnosed(tmp_path / name, MotorUnit(stiffness=0.6), system, 20.0)
        assert [cause["name"] for cause in found["causes"]] == causes
