"""A cart with dry friction is named as what it is."""

import pytest

from deepkoco.diagnose import diagnose
from tests.systems.cart_pole import CartPole, cart_pole_log

FRICTION = 0.7  # [N]


@pytest.fixture(scope="module")
def rubbing():
    return diagnose([cart_pole_log(FRICTION, 0, 14.0)], CartPole(), only=["coulomb", "stribeck", "viscous"])


def test_dry_friction_of_a_cart_is_named_coulomb_and_not_stribeck(rubbing):
    assert rubbing.verdict == "cause"
    (cause,) = rubbing.causes
    assert cause.members == ("coulomb(joint 1)",)
    assert cause.parameters["coulomb(joint 1).torque"].value == pytest.approx(FRICTION, rel=0.01)
    assert cause.parameters["coulomb(joint 1).torque"].unit == "N"
    # What was simulated as creep and late reversals left 156 noise variances per sample.
    assert rubbing.chi2_after < 1.15
