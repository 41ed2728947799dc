"""The study of robots of MuJoCo: fair order, the same case for the same numbers, and the judgement of a report."""

import numpy as np
import pytest

from experiments.studies.diagnosis.own_robots.__main__ import counts, judge, order
from experiments.studies.diagnosis.own_robots.cases import Case, draw_case, joints_of, right_names
from tests.oracle.mujoco_robots import cart_pole, random_arm
from tests.oracle.mujoco_unit import Hidden


def case(kind="damping", joint="j2", drive="position", cost=100.0) -> Case:
    robot = random_arm(np.random.default_rng(0), 3, drive)
    return Case(0, 0, robot, Hidden(kind, joint, 0.1), 10.0, cost)


def named(*classes, verdict="cause", same=()):
    causes = [{"name": names[0], "class": list(names)} for names in classes]
    if causes and same:
        causes[0]["same_as"] = [{"name": name} for name in same]
    return {"verdict": verdict, "causes": causes}


@pytest.mark.parametrize(("hidden", "healthy"), [(40, 20), (3, 3), (5, 0)])
def test_every_beginning_of_the_study_has_its_share_of_healthy_cases(hidden, healthy):
    listed = order(hidden, healthy)
    assert sum(listed) == healthy
    for k in range(len(listed)):
        assert abs(sum(listed[:k]) - k * healthy / len(listed)) <= 1.0


@pytest.mark.study
def test_a_case_is_the_same_whatever_was_drawn_before():
    first, again = draw_case(7, 0, 4.0, healthy=False), draw_case(7, 0, 4.0, healthy=False)
    assert first == again
    assert draw_case(8, 0, 4.0, healthy=True).hidden is None
    assert joints_of(7, 0) == first.joints


@pytest.mark.parametrize(
    ("answer", "right"),
    [
        (named(["viscous(j2)"]), True),
        (named(["viscous(j1)"]), False),
        (named(["gain(j2)", "viscous(j2)"], verdict="ambiguous"), True),
        (named(["changed(com_x(link2))"], same=["damping(j2)"]), True),
        (named(["coulomb(j2)"], ["viscous(j2)"]), False),
        (named(["viscous(j2)"], verdict="unknown"), False),
        (None, False),
    ],
)
def test_a_hidden_effect_counts_where_the_first_cause_has_it_in_its_class(answer, right):
    assert judge(case(), answer)["right"] == int(right)


def test_a_healthy_unit_counts_where_nothing_is_named():
    robot = cart_pole(np.random.default_rng(0))
    healthy = Case(0, 0, robot, None, 0.0)
    assert judge(healthy, named(verdict="nothing"))["right"] == 1
    assert judge(healthy, named(["coulomb(slider)"]))["right"] == 0
    assert judge(healthy, named(["unknown"], verdict="unknown"))["right"] == 0


def test_nothing_is_right_only_for_what_the_file_allows():
    assert judge(case(cost=5.0), named(verdict="nothing"))["right"] == 1
    assert judge(case(cost=5.0), named(["viscous(j2)"]))["right"] == 1
    assert judge(case(cost=5.0), named(["viscous(j1)"]))["right"] == 0
    assert judge(case(), named(verdict="nothing"))["right"] == 0


def test_nothing_is_right_where_the_refit_reached_the_noise_within_the_priors_of_the_file():
    near, far = (
        {**named(verdict="nothing"), "fit": {"prior_sds": {"m": sds, "b": 1.0}}} for sds in (5.0, 6.0)
    )
    assert (judge(case(), near)["right"], judge(case(), near)["refit_cost"]) == (1, "26")
    assert (judge(case(), far)["right"], judge(case(), far)["refit_cost"]) == (0, "37")
    named_one = {**near, "verdict": "cause"}
    assert judge(case(), named_one)["refit_cost"] == ""


def test_names_of_an_effect_are_those_at_its_own_joint_body_and_actuator():
    assert right_names(case("gain")) == {"gain(j2)", "changed(kp(m2))"}
    assert right_names(case("gain", drive="motor")) == {"gain(j2)", "changed(gain(m2))"}
    assert right_names(case("payload", "j3")) == {"payload", "changed(mass(link3))"}
    assert right_names(case("payload", "j2")) == {"payload(link2)", "changed(mass(link2))"}


def test_an_armature_is_the_inertia_of_a_body_that_no_hinge_turns_before():
    robot = cart_pole(np.random.default_rng(0))
    pole, cart = (Case(0, 0, robot, Hidden("armature", n, 0.1), 10.0) for n in ("pivot", "slider"))
    assert right_names(pole) >= {"armature(pivot)", "changed(inertia_y(pole))"}
    assert right_names(cart) >= {"armature(slider)", "changed(mass(cart))", "payload(cart)"}
    load = Case(0, 0, robot, Hidden("payload", "slider", 0.1), 10.0)
    assert right_names(load) == right_names(cart) - {"changed(armature(slider))"}
    assert not any("inertia" in name for name in right_names(case("armature", "j3")))


def test_counts_tell_apart_what_is_wrong_and_what_is_not_named():
    rows = [
        {"kind": "gain", "cost": "90", "right": "1", "further": "", "verdict": "cause", "cpu_s": "3"},
        {"kind": "gain", "cost": "90", "right": "0", "further": "", "verdict": "unknown", "cpu_s": "5"},
        {"kind": "gain", "cost": "2", "right": "1", "further": "", "verdict": "nothing", "cpu_s": "6"},
        {"kind": "", "cost": "0", "right": "1", "further": "", "verdict": "nothing", "cpu_s": "1"},
        {"kind": "", "cost": "0", "right": "0", "further": "", "verdict": "cause", "cpu_s": "9"},
    ]
    found = counts(rows)
    assert (found["hidden"], found["in_class"], found["unknown"], found["nothing"]) == (2, 1, 1, 0)
    assert (found["allowed"], found["allowed_right"]) == (1, 1)
    assert (found["healthy"], found["healthy_named"], found["median_cpu_s"]) == (2, 1, 5.0)
