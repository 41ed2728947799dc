"""What every page has: a way to the other pages, date and versions, and numbers that can be read."""

import math
from datetime import date

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.pages import in_one_unit, less, link_pages, links_between, made_on, readable, software
from deepkoco.pages.links import navigation
from deepkoco.pages.units import plain


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (3.6e-5, "m", "36 µm"),
        (0.02, "s", "20 ms"),
        (0.5, "N m", "0.5 N m"),
        (1.5, "1", "1.5"),
        (0.012, "kg", "12 g"),
        (4.6e-5, "N m s/rad", "46 µN m s/rad"),
        (1234.5, "N", "1,234 N"),
        (0.0, "m", "0 m"),
        (1e-9, "kg m2", "1.00·10^-9 kg m2"),
        (math.nan, "m", "unknown m"),
    ],
)
def test_a_number_is_given_in_the_unit_in_which_people_read_it(value, unit, text):
    assert readable(value, unit) == text


def test_numbers_that_are_compared_share_the_unit_of_the_largest():
    assert in_one_unit([0.0131, 3.6e-5], "m") == (["13.1", "0.036"], "mm")
    assert in_one_unit([0.134, 0.00203], "rad") == (["0.134", "0.00203"], "rad")


def test_an_error_that_fell_is_told_as_a_ratio():
    assert less(0.0131, 3.6e-5) == "360 times less"
    assert less(1.0, 0.75) == "25 % less"
    assert less(1.0, 1.12) == "12 % more"
    assert less(1.0, 3.0) == "3 times more"
    assert less(1.0, 1.0) == "the same"


@given(st.floats(1e-4, 1e6))
def test_a_number_written_plainly_is_the_number_to_its_digits(value):
    assert float(plain(value, 4).replace(",", "")) == pytest.approx(value, rel=6e-4)


def test_pages_are_linked_where_they_exist_and_only_their_navigation_changes(tmp_path):
    pages = {
        "Demo": tmp_path / "index.html",
        "Diagnosis": tmp_path / "a b" / "report.html",
        "Model": tmp_path / "runs" / "analysis.html",
    }
    (tmp_path / "a b").mkdir()
    for name in ("Demo", "Diagnosis"):
        pages[name].write_text(f"<body>{navigation([])}<p>{name}</p></body>")
    link_pages(pages)
    demo, report = (pages[name].read_text() for name in ("Demo", "Diagnosis"))
    assert '<a href="a%20b/report.html">Diagnosis</a>' in demo
    assert '<a href="../index.html">Demo</a>' in report
    assert '<b aria-current="page">Diagnosis</b>' in report
    assert "Model" not in demo + report
    assert demo.endswith("</nav><p>Demo</p></body>")
    link_pages(pages)
    assert pages["Demo"].read_text() == demo
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a b", "index.html"]
    assert [link.text for link in links_between(pages["Demo"], pages)] == ["Demo", "Diagnosis"]


def test_the_date_of_a_page_can_be_fixed(monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    assert made_on() == date(1970, 1, 2)
    assert list(software("numpy", "no-such-package")) == ["deepkoco", "python", "numpy"]
