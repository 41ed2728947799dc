"""The family of a cause that is not in the catalogue: told where one family alone comes near, and not elsewhere."""

from dataclasses import replace

import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.report.text import headline
from deepkoco.diagnose.report.unexplained_text import remains
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

RUBS = ("viscous", "quadratic")
OTHERS = ("gain", "lag", "torque_bias")


def unknown(only):
    """A diagnosis of dry friction with a catalogue that has none."""
    log = hidden_log("rod_pendulum", {"coulomb": {"torque": 0.15}}, "steps", 7, 8.0)
    result = diagnose([log], make_system("rod_pendulum"), only=only)
    assert result.verdict == "unknown"
    return result


def test_friction_of_another_shape_is_told_as_friction():
    result = unknown([*RUBS, *OTHERS])
    family = result.unexplained["family"]
    assert family["name"] == "friction"
    assert family["cause"] in RUBS
    assert family["share"] >= 0.6
    assert family["probability"] >= 0.9
    assert "friction of a shape that is not in the catalogue" in headline(result)
    assert any(f"{family['cause']} explains" in text for text in remains(result))
    assert "family" in result.to_json()["unexplained"]


def test_no_family_is_told_where_none_comes_near():
    result = unknown(OTHERS)
    assert "family" not in result.unexplained
    assert "no cause of the catalogue" in headline(result)


@pytest.mark.parametrize("verdict", ["cause", "nothing"])
def test_a_named_cause_needs_no_family(verdict):
    log = hidden_log(
        "rod_pendulum", {"viscous": {"change": 0.1}} if verdict == "cause" else {}, "steps", 8, 8.0
    )
    result = diagnose([log], make_system("rod_pendulum"), only=["viscous", "gain"])
    assert result.verdict == verdict
    assert "family" not in result.unexplained
    assert headline(replace(result, unexplained={})) == headline(result)
