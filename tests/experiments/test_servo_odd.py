"""The odd servos of the study: without an effect they are the usual unit, and every effect shows."""

import numpy as np
import pytest

from experiments.studies.diagnosis.servo_odd import USUAL, with_usual
from tests.oracle.odd_servos import ODD, OddServo
from tests.oracle.servo_unit import go1_like, log_of


def angles(recording):
    return recording.channels["theta"].value


def test_servo_without_an_odd_effect_is_the_usual_unit():
    unit = go1_like()
    np.testing.assert_array_equal(
        angles(OddServo(unit).log("sin_sin", 3, seconds=1.0)), angles(log_of(unit, "sin_sin", 3, seconds=1.0))
    )


@pytest.mark.parametrize("effect", [*ODD, *USUAL])
def test_every_hidden_effect_shows_in_the_motion(effect):
    unit = go1_like()
    usual = angles(OddServo(unit).log("sin_sin", 3, seconds=2.0))
    hidden = OddServo(with_usual(unit, effect), effect if effect in ODD else "")
    assert np.abs(angles(hidden.log("sin_sin", 3, seconds=2.0)) - usual).max() > 2e-3
