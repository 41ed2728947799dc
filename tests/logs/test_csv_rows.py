"""Rows of a CSV: a broken one is refused with the line that an editor shows."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepkoco.logs import LogError, read_log
from deepkoco.logs.formats import open_log

MAPPING = {
    "time": {"column": "t", "unit": "s"},
    "channels": {
        "torque": {"column": "tau", "unit": "N m", "kind": "command"},
        "theta": {"column": "pos", "unit": "rad", "kind": "measurement"},
    },
}


def rows(count: int = 60) -> list[str]:
    t = 0.05 * np.arange(count)
    return [f"{a:.6g},{np.sin(a):.6g},{np.cos(a):.6g}" for a in t]


def refusal(folder, lines: list[str], end: str = "\n") -> str:
    path = folder / "log.csv"
    path.write_text("\n".join(["t,tau,pos", *lines]) + end)
    with pytest.raises(LogError) as caught:
        read_log(path, MAPPING)
    return str(caught.value)


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ("0.5,1.0", "line 12 has 2 cells and the header has 3 names; complete or delete the line"),
        ("0.5,1.0,2.0,3.0", "line 12 has 4 cells and the header has 3 names"),
        ("0.5,1.0,3 deg", 'column "pos": "3 deg" at line 12 is no number'),
        ("0.45,1.0,2.0", 'column "t": 1 sample with a duplicate time stamp, at line 12'),
        ("0.1,1.0,2.0", 'column "t": 1 sample earlier than the row before, at line 12'),
        ("0.5,1.0,", 'column "pos": 1 sample NaN or infinite (rad), at line 12'),
    ],
)
def test_read_log_names_the_line_of_a_broken_row(tmp_path, broken, message):
    lines = rows()
    lines[10] = broken
    assert message in refusal(tmp_path, lines)


def test_read_log_says_that_a_file_is_cut_off(tmp_path):
    lines = rows()
    lines[-1] = lines[-1].partition(",")[0]
    message = refusal(tmp_path, lines, end="")
    assert f"line {len(lines) + 1} has 1 cell and" in message
    assert "cut off" in message


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(blank=st.lists(st.integers(0, 39), max_size=4), bad=st.integers(0, 39))
def test_lines_count_blank_lines_and_quoted_line_breaks(tmp_path_factory, blank, bad):
    """The reported line is the place of the marked cell in the text, found by a search of the text."""
    lines = [f'{0.1 * k:.3g},{k},"a\nb"' if k % 7 == 3 else f"{0.1 * k:.3g},{k},c" for k in range(40)]
    lines[bad] = f"{0.1 * bad:.3g},bad,c"
    for place in sorted(blank, reverse=True):
        lines.insert(place, "  " if place % 2 else "")
    text = "\n".join(["t,x,name", *lines]) + "\n"
    path = tmp_path_factory.mktemp("csv") / "log.csv"
    path.write_text(text)
    log = open_log(path)
    with pytest.raises(LogError) as caught:
        log.values("", "x")
    line = text[: text.index("bad")].count("\n") + 1
    assert f'"bad" at line {line} is no number' in str(caught.value)


def test_open_log_accepts_a_delimiter_at_the_end_of_rows(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,x\n0,1,\n1,2,\n")
    assert open_log(path).values("", "x").tolist() == [1.0, 2.0]
    path.write_text("t,x,\n0,1\n1,2\n")
    assert open_log(path).values("", "x").tolist() == [1.0, 2.0]


def test_open_log_splits_lists_in_cells(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text('timestamp,positions\n1.5,"[0.25, -1e-3]"\n20000.5,"[nan, 2]"\n')
    log = open_log(path)
    np.testing.assert_array_equal(log.values("", "positions[0]"), [0.25, np.nan])
    np.testing.assert_array_equal(log.values("", "positions[1]"), [-1e-3, 2.0])


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("[0.1]", "line 3 has a list of 1 numbers, the lines before have 2"),
        ("[0.1, x]", "line 3 is no list of numbers"),
        ("[[1, 2], [3, 4]]", "line 3 is no list of numbers"),
    ],
)
def test_open_log_names_the_line_of_a_broken_list(tmp_path, cell, message):
    path = tmp_path / "log.csv"
    path.write_text(f't,q\n0,"[0.1, 0.2]"\n1,"{cell}"\n')
    with pytest.raises(LogError, match=message.replace("[", r"\[")):
        open_log(path)
