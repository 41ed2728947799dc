"""A cart with dry friction: named as what it is, in the words and units of a joint that slides."""

import json

import pandas as pd
import pytest

from deepkoco.diagnose import diagnose, write_report
from tests.systems.cart_pole import CartPole, cart_pole_log

FRICTION = 0.7  # [N]


@pytest.fixture(scope="module")
def rubbing():
    return diagnose([cart_pole_log(FRICTION, 0, 14.0)], CartPole(), only=["coulomb", "stribeck", "viscous"])


@pytest.fixture(scope="module")
def report(rubbing, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cart") / "report"
    write_report(rubbing, folder)
    return folder


@pytest.mark.study
def test_dry_friction_of_a_cart_is_named_coulomb_and_not_stribeck(rubbing):
    assert rubbing.verdict == "cause"
    (cause,) = rubbing.causes
    assert cause.members == ("coulomb(cart)",)
    assert cause.parameters["coulomb(cart).torque"].value == pytest.approx(FRICTION, rel=0.01)
    assert cause.parameters["coulomb(cart).torque"].unit == "N"
    # What was simulated as creep and late reversals left 156 noise variances per sample.
    assert rubbing.chi2_after < 1.15


@pytest.mark.study
def test_report_speaks_of_the_cart_in_metres_and_newtons(report):
    said = json.loads((report / "report.json").read_text())
    assert (
        "theta_rad" not in said["unexplained"]["worst"]
        or said["unexplained"]["worst"]["joint_name"] == "pole"
    )
    assert {place["channel"] for place in said["localisation"]} <= {"load on cart", "load on pole"}
    page = (report / "report.html").read_text()
    assert "coulomb (cart)" in page
    assert "joint 1" not in page
    table = pd.read_csv(report / "missing_torque.csv")
    assert {"position_m", "speed_m_s", "missing_force_n", "named_cause_n"} <= set(table.columns)


@pytest.mark.study
def test_model_of_a_named_joint_keeps_its_effect(rubbing):
    assert [e.name for e in rubbing.model.effects] == ["coulomb(cart)"]
