"""A parameter that is several stated standard deviations off is the answer, and one within them is not."""

import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.report.text import headline
from tests.diagnose.test_changed_parameter import Misread
from tests.systems.cart_pole import POLE_MASS, cart_pole_log


@pytest.fixture(scope="module")
def log():
    return cart_pole_log(seed=4, seconds=12.0)


@pytest.mark.parametrize("sd", [0.016, 0.019])
def test_a_mass_that_is_over_four_stated_deviations_off_is_named(log, sd):
    # The fall of the BIC by the prior alone, 4.2^2 to 5^2 less the charge for a parameter, is no 24.
    result = diagnose([log], Misread(0.12, sd), only=["changed", "coulomb"])
    assert result.verdict == "cause"
    (cause,) = result.causes
    assert cause.name == "changed(pole_mass)"
    assert result.detection <= cause.delta_bic < DETECTION
    assert cause.parameters["pole_mass"].value == pytest.approx(POLE_MASS, rel=0.01)
    assert cause.probabilities["changed(pole_mass)"] > 0.5
    assert headline(result).startswith("pole mass is 0.2 kg, not 0.12 kg")


def test_a_mass_within_three_stated_deviations_is_no_cause_and_is_told(log):
    result = diagnose([log], Misread(0.12, 0.03), only=["changed", "coulomb"])
    assert result.verdict == "nothing"
    assert [m.name for m in result.moved] == ["pole_mass"]


def test_the_headline_says_what_a_refit_within_a_wide_prior_is_worth(log):
    result = diagnose([log], Misread(0.12, 0.2), only=["coulomb"])
    assert result.verdict == "nothing"
    assert result.moved == ()
    assert "once its own parameters are refitted: as given, its held-out error" in headline(result)
