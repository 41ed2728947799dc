"""Causes chosen by the names that a user gives."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose import CAUSES, UnknownCauseError, diagnose
from deepkoco.diagnose.causes import catalogue, causes_named, kind_of
from deepkoco.logs.recording import Recording
from deepkoco.systems import make_system

ARM = catalogue(make_system("two_link_arm"))


@settings(deadline=None)
@given(st.sampled_from(sorted({kind_of(name) for name in ARM})))
def test_causes_named_by_kind_are_those_of_every_place(kind):
    chosen = [cause.name for cause in causes_named(ARM, [kind], "two_link_arm")]
    assert chosen == [name for name in ARM if kind_of(name) == kind]


@settings(deadline=None)
@given(st.lists(st.sampled_from(sorted(ARM))))
def test_causes_named_in_full_are_these_alone_and_each_once(names):
    assert [cause.name for cause in causes_named(ARM, names, "two_link_arm")] == list(dict.fromkeys(names))


def test_causes_named_takes_a_name_and_its_kind_once():
    chosen = causes_named(ARM, ["coulomb(joint 2)", "coulomb"], "two_link_arm")
    assert [cause.name for cause in chosen] == ["coulomb(joint 2)", "coulomb(joint 1)"]


@pytest.mark.parametrize(("wrong", "meant"), [("columb", "coulomb"), ("coulomb(joint2)", "coulomb(joint 2)")])
def test_unknown_cause_is_refused_with_the_nearest_and_all_known_names(wrong, meant):
    with pytest.raises(UnknownCauseError) as caught:
        causes_named(ARM, [wrong], "two_link_arm")
    said, known = str(caught.value).split("it has: ")
    assert f'two_link_arm has no cause "{wrong}"; did you mean ' in said
    assert meant in said
    assert known.split(", ") == list(ARM)


def test_diagnose_refuses_an_unknown_cause_before_it_looks_at_the_logs():
    assert "friction" not in CAUSES
    with pytest.raises(UnknownCauseError, match='two_link_arm has no cause "friction"'):
        diagnose([Recording({})], "two_link_arm", only=["friction"])
