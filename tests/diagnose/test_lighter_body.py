"""A body that has lost mass: a payload moves the measurements alike, but takes no mass away."""

import pytest

from deepkoco.diagnose import diagnose
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log


def log(mass, take):
    return hidden_log("quadrotor_height", {"payload": {"mass": mass}}, "steps", 300, 20.0, take=take)


def test_a_body_that_became_lighter_has_another_mass():
    result = diagnose([log(-0.004, take=1)], "quadrotor_height", healthy=[log(0.0, take=0)])
    assert result.verdict == "cause"
    assert result.names == ("changed(mass)",)
    given = make_system("quadrotor_height").parameter("mass").value
    assert result.causes[0].parameters["mass"].value == pytest.approx(given - 0.004, rel=0.05)


def test_a_body_that_became_heavier_has_a_payload():
    result = diagnose([log(0.004, take=1)], "quadrotor_height", healthy=[log(0.0, take=0)])
    assert "payload" in result.causes[0].members
    assert result.causes[0].parameters["payload.mass"].value == pytest.approx(0.004, rel=0.1)
