"""CSV files as other programs write them: comments, units in a row of their own, times of the day."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.logs.formats import open_log
from deepkoco.logs.formats.csv_head import read_head
from deepkoco.logs.formats.log_file import LogError, iso_seconds
from deepkoco.logs.formats.recordings import recordings
from deepkoco.logs.inspect import doubts_of, propose, survey_log
from deepkoco.logs.inspect.fitting import NoProposalError

ROWS = "0.00,1.5,-2\n0.01,1.25,3\n0.02,1,4\n"


def read(tmp_path, text):
    (tmp_path / "log.csv").write_text(text)
    return open_log(tmp_path / "log.csv")


@pytest.mark.parametrize(
    ("head", "names"),
    [
        ("t,q,u\n", ["t", "q", "u"]),
        ("# rig 3\n# Monday\nt,q,u\n", ["t", "q", "u"]),
        ("# rig 3\n# t,q,u\n", ["t", "q", "u"]),
        ("% t,q,u\n", ["t", "q", "u"]),
        ("t,q,u\ns,deg,N m\n", ["t [s]", "q [deg]", "u [N m]"]),
        ("t,q,u\n[s],[deg],-\n", ["t [s]", "q [deg]", "u [-]"]),
        ("# rig\nt,q,u\n(s),(rad),(Nm)\n", ["t [s]", "q [rad]", "u [Nm]"]),
    ],
)
def test_comments_and_a_row_of_units_stand_around_the_header(tmp_path, head, names):
    log = read(tmp_path, head + ROWS)
    frame = log.table("").frame
    assert list(frame.columns) == names
    np.testing.assert_array_equal(log.values("", names[1]), [1.5, 1.25, 1.0])
    assert bool(log.notes) == (head != "t,q,u\n")


@pytest.mark.parametrize("head", ["t,q,u\n", "# a\n#b\nt,q,u\n", "# t,q,u\n", "t,q,u\ns,deg,N\n"])
def test_a_broken_row_is_named_by_its_line_of_the_file(tmp_path, head):
    line = head.count("\n") + 4
    with pytest.raises(LogError, match=f"line {line} has 2 cells"):
        read(tmp_path, head + ROWS + "0.03,1\n" + ROWS)


@pytest.mark.parametrize("ending", [".csv", ".txt", ".tsv"])
@pytest.mark.parametrize("head", ["t  q u\n", "# t q u\n"])
def test_spaces_between_columns_are_read_as_numpy_writes_them(tmp_path, head, ending):
    path = tmp_path / f"log{ending}"
    path.write_text(head + " 0.00 1.5  -2\n 0.01 1.25 3\n")
    log = open_log(path)
    assert list(log.table("").frame.columns) == ["t", "q", "u"]
    np.testing.assert_array_equal(log.values("", "u"), [-2.0, 3.0])


def test_a_row_of_text_that_is_no_unit_stays_a_row(tmp_path):
    log = read(tmp_path, "t,q,note\n0.0,1,m\n0.1,2,s\n")
    assert len(log.table("").frame) == 2


@settings(max_examples=60, deadline=None)
@given(st.text(alphabet="#%/,;tq01.-s\n ", max_size=40))
def test_a_head_is_read_or_left_alone_and_no_row_is_lost(text):
    head = read_head(text)
    kept, before = head.text.split("\n"), text.split("\n")
    assert len(kept) + head.ahead == len(before)
    rows = [line.lstrip("#%").split() for line in kept[1:]]
    assert rows == [line.lstrip("#%").split() for line in before[head.ahead + 1 :]]


def test_a_cell_of_text_among_numbers_is_named_by_its_line(tmp_path):
    survey = survey_log(
        read(tmp_path, "t,q,note\n" + "".join(f"{k / 10},{k},a\n" for k in range(9)) + "0.9,off,b\n")
    )
    (found,) = [doubt for doubt in doubts_of(survey) if "column of numbers" in doubt]
    assert '"q"' in found
    assert '"off" at line 11' in found


def test_times_of_a_day_go_on_after_midnight(tmp_path):
    log = read(tmp_path, "clock,q\n23:59:59.900,1\n23:59:59.950,2\n0:00:00.000,3\n00:00:00.05,4\n")
    seconds = iso_seconds(log, "", "clock")
    np.testing.assert_allclose(np.diff(seconds), 0.05, atol=1e-9)


def test_a_log_without_a_time_is_refused_in_one_sentence(tmp_path):
    frame = pd.DataFrame({"q_shoulder": [3.0, 1.0, 2.0], "note": ["a", "b", "c"]})
    (tmp_path / "arm.xml").write_text(
        '<mujoco><worldbody><body><joint name="shoulder"/><geom size=".1" pos=".1 0 0"/></body></worldbody></mujoco>'
    )
    survey = survey_log(read(tmp_path, frame.to_csv(index=False)))
    with pytest.raises(NoProposalError, match="no column is a time"):
        propose(survey, str(tmp_path / "arm.xml"))


@pytest.mark.parametrize("suffix", [".dat", ".log", ".prn", ".TXT"])
def test_a_text_is_read_as_the_table_that_it_is_whatever_its_name_ends_in(tmp_path, suffix):
    rows = (
        "# finger 4, serial 17\n# angles in rad\n# time q tau_mNm\n  8.11  0.30  0.05\n  8.12  0.31 -1.78\n"
    )
    path = tmp_path / f"log{suffix}"
    path.write_text(rows)
    log = open_log(path)
    assert list(log.table("").frame.columns) == ["time", "q", "tau_mNm"]
    np.testing.assert_array_equal(log.values("", "q"), [0.30, 0.31])
    assert [p.name for p in recordings([tmp_path])] == [path.name]


def test_a_text_that_is_no_table_has_no_format(tmp_path):
    (tmp_path / "notes.dat").write_text("Monday: the finger was oiled.\nTuesday: it was not.\n")
    with pytest.raises(LogError, match=r'format "\.dat" is not known'):
        open_log(tmp_path / "notes.dat")
    with pytest.raises(LogError, match="contains no log"):
        recordings([tmp_path])


@pytest.mark.parametrize("comments", ["# made by X\n", "// made by X\n", "# made by X\n# on Monday\n"])
@pytest.mark.parametrize("sign", ["", "# ", "// "])
def test_comments_above_a_header_with_spaces_stay_comments(tmp_path, comments, sign):
    log = read(tmp_path, f"{comments}{sign}t q /arm/u\n0 1 5\n1 2 6\n")
    assert list(log.table("").frame.columns) == ["t", "q", "/arm/u"]
    np.testing.assert_array_equal(log.values("", "q"), [1, 2])
