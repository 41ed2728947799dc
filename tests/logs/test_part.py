"""A part of a log, named by its path."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.cli.logs import result_folder
from deepkoco.excitation.record import record
from deepkoco.logs import LogError, read_log, read_logs, write_log
from deepkoco.logs.part import named_part, split_part
from deepkoco.unit import make_unit

TIMES = st.floats(-1e4, 1e4).map(lambda t: float(f"{t:.6g}"))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    unit = make_unit("torque_pendulum", seed=1)
    path = tmp_path_factory.mktemp("logs") / "run.csv"
    return write_log(path, record(unit, "prbs", 6.0, clock="simulated", seed=1))


@given(start=TIMES, seconds=st.floats(0.1, 1e3))
def test_a_part_is_read_from_its_name_as_it_was_written(start, seconds):
    stop = float(f"{start + seconds:.6g}")
    if start < stop:
        assert split_part(named_part("a/log.csv", start, stop)) == (Path("a/log.csv"), (start, stop))
    assert split_part(named_part("log.csv", start)) == (Path("log.csv"), (start, math.inf))
    assert split_part(named_part("log.csv", stop=stop)) == (Path("log.csv"), (-math.inf, stop))


def test_a_part_has_the_samples_of_its_time_and_its_own_path(log):
    whole, part = read_log(log), read_log(f"{log}#t=1.5,4")
    assert part.path.name == "run.csv#t=1.5,4"
    for name in whole.names("measurement"):
        a, b = whole.channels[name], part.channels[name]
        inside = (a.t >= 1.5) & (a.t <= 4.0)
        assert np.array_equal(b.t, a.t[inside])
        assert np.array_equal(b.value, a.value[inside])
    (command,) = whole.names("command")
    assert part.channels[command].t[0] <= 1.5  # the command that holds at the begin


def test_parts_are_logs_wherever_logs_are_given(log):
    first, second = read_logs([f"{log}#t=,3", f"{log}#t=3"], "torque_pendulum")
    assert (first.stop, second.start) == (pytest.approx(3.0, abs=0.02), pytest.approx(3.0, abs=0.02))


@pytest.mark.parametrize("text", ["", ",", "4,2", "2,2", "a,3", "nan", "1,2,3"])
def test_what_is_no_range_of_times_is_refused_with_examples(log, text):
    with pytest.raises(LogError, match=r"#t=2,7\.5"):
        read_log(f"{log}#t={text}")


def test_a_part_that_the_log_does_not_have_is_refused_with_the_times_of_the_log(log):
    with pytest.raises(LogError, match="this part has 0 s and needs 1 s; the log lasts from 0 to"):
        read_log(f"{log}#t=30,40")


def test_a_part_of_a_folder_of_logs_is_refused(log):
    with pytest.raises(LogError, match="a part is one of a single recording"):
        read_logs([f"{log.parent}#t=1,4"], "torque_pendulum")


def test_a_file_whose_name_has_the_mark_is_a_whole_log(tmp_path):
    path = tmp_path / "odd#t=1.csv"
    path.touch()
    assert split_part(path) == (path, None)


def test_the_folder_of_a_result_is_named_after_the_part(tmp_path):
    name = tmp_path / "run.csv#t=,7.5"
    assert result_folder(None, name, "_diagnosis").name == "run_to_7.5_s_diagnosis"
    assert result_folder(None, tmp_path / "run.csv#t=2", "_diagnosis").name == "run_from_2_s_diagnosis"
