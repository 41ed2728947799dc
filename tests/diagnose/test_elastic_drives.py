"""A belt that gives, where the simulation as given has a stiff one."""

import pytest

from deepkoco.diagnose.causes import catalogue
from deepkoco.systems import ExtendedSystem, load_system, make_system
from deepkoco.systems.stretchable import may_stretch, stretchable, stretchable_if_asked
from tests.diagnose.test_own_robots import CART, MOTOR, diagnosed
from tests.oracle.own_robots import MotorUnit


@pytest.mark.study
@pytest.mark.long
@pytest.mark.parametrize(("stiffness", "hertz"), [(0.6, 10.07), (0.1, 4.11)])
def test_an_elastic_belt_is_named_with_its_frequency_and_its_share(tmp_path, stiffness, hertz):
    report = diagnosed(tmp_path, MotorUnit(stiffness=stiffness), MOTOR, 20.0)
    assert report["verdict"] == "cause"
    found = report["causes"][0]
    assert found["name"] == "elastic"
    assert found["parameters"]["elastic.frequency"]["value"] == pytest.approx(hertz, rel=0.05)
    assert found["parameters"]["elastic.share"]["value"] == pytest.approx(0.75, abs=0.05)
    model = load_system(tmp_path / "report" / "model.yaml")
    assert model.state_names == (
        "joint 1",
        "stretch of joint 1",
        "joint 1 speed",
        "rate of the stretch of joint 1",
    )


def test_only_driven_joints_have_the_cause_and_only_with_a_stretch():
    cart = load_system(CART)
    assert not [name for name in catalogue(cart) if name.startswith("elastic")]
    wider = catalogue(stretchable(cart))
    assert [name for name in wider if name.startswith("elastic")] == ["elastic(cart)"]
    assert wider.keys() - {"elastic(cart)"} == catalogue(cart).keys()


def test_a_simulation_with_a_stretch_gets_no_second_one():
    motor = load_system(MOTOR)
    assert may_stretch(motor)
    assert not may_stretch(stretchable(motor))
    assert stretchable_if_asked(motor, None) is motor
    assert stretchable_if_asked(motor, ["coulomb"]) is motor
    assert stretchable_if_asked(motor, "elastic").joints == 2
    extended = ExtendedSystem(make_system("rod_pendulum"), ("gain",), {"gain.factor": 0.9})
    assert stretchable(extended).parameter("gain.factor").value == 0.9
