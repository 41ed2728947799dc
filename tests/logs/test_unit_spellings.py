"""Spellings of units."""

import math

import pytest

from deepkoco.logs.inspect.names import read_name
from deepkoco.logs.units import UnitError, parse_unit, usual_spelling


@pytest.mark.parametrize(
    ("given", "usual"),
    [
        ("Grad", "deg"),
        ("1/min", "rpm"),
        ("U/min", "rpm"),
        ("MM", "mm"),
        ("NM", "N m"),
        ("Rad", "rad"),
        ("°", "deg"),
    ],
)
def test_units_are_known_in_the_spellings_of_other_programs(given, usual):
    assert usual_spelling(given) == usual
    assert parse_unit(given) == parse_unit(usual)


@pytest.mark.parametrize("given", ["MN", "MV", "MA", "G", "furlong"])
def test_a_capital_that_may_mean_a_million_is_no_unit_of_a_thousandth(given):
    with pytest.raises(UnitError):
        parse_unit(given)


def test_a_name_gives_the_usual_spelling_and_its_quantity():
    assert read_name("Ruecken [Grad]").unit == "deg"
    assert parse_unit("1/min").factor == pytest.approx(2.0 * math.pi / 60.0)
