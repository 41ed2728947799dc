"""A part of a log, named by its path."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.cli.command_line import main
from deepkoco.cli.logs import result_folder
from deepkoco.excitation.record import record
from deepkoco.logs import LogError, read_log, read_logs, write_log
from deepkoco.logs.part import named_part, split_part
from deepkoco.unit import make_unit

TIMES = st.floats(-1e4, 1e4).map(lambda t: round(t, 3) + 0.0)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    unit = make_unit("torque_pendulum", seed=1)
    path = tmp_path_factory.mktemp("logs") / "run.csv"
    return write_log(path, record(unit, "prbs", 6.0, clock="simulated", seed=1))


@given(start=TIMES, seconds=st.floats(0.1, 1e3))
def test_a_part_is_read_from_its_name_as_it_was_written(start, seconds):
    stop = round(start + seconds, 3)
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


def test_a_part_of_a_part_is_one_of_the_log():
    assert named_part("log.csv#t=2,30", 12.5) == "log.csv#t=12.5,30"
    assert named_part("log.csv#t=2,30", stop=12.5) == "log.csv#t=2,12.5"
    assert named_part("log.csv#t=2", 1.0) == "log.csv#t=2"


def test_stamps_of_a_machine_that_runs_for_weeks_keep_their_milliseconds():
    assert named_part("log.csv", 1234567.8) == "log.csv#t=1234567.8"
    assert result_folder(None, Path("run.csv#t=1234561.2"), "_d").name == "run_from_1234561.2_s_d"


def test_a_command_that_was_sent_long_before_a_part_holds_in_it(tmp_path, log):
    whole = read_log(log)
    (name,) = whole.names("command")
    few = replace(whole.channels[name], t=np.array([0.0, 1.0]), value=np.array([0.1, 0.2]))
    path = write_log(tmp_path / "few.csv", replace(whole, channels={**whole.channels, name: few}))
    command = read_log(f"{path}#t=4").channels[name]
    assert (command.t.tolist(), command.value.tolist()) == ([4.0], [0.2])


def test_inspect_says_that_it_looks_at_whole_logs(log, capsys):
    assert main(["inspect", f"{log}#t=1,4"]) == 2
    assert "inspect looks at whole logs" in capsys.readouterr().err


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
