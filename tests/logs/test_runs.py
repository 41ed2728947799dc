"""A table whose clock begins again is several logs, one for each run."""

import argparse

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.cli.logs import read_logs as logs_of_command
from deepkoco.logs import LogError, read_log, read_logs
from deepkoco.logs.formats.open_log import files_kept, open_log
from deepkoco.logs.runs import MARK, runs_of, split_run

MAPPING = {
    "time": {"column": "t", "unit": "s"},
    "channels": {
        "torque": {"column": "u", "unit": "N m", "kind": "command"},
        "theta": {"column": "q", "unit": "rad", "kind": "measurement"},
    },
}


def table(*lengths):
    parts = []
    for number, n in enumerate(lengths):
        t = 0.02 * np.arange(n)
        parts.append(pd.DataFrame({"t": t, "u": np.sin(t + number), "q": 0.1 * number + np.cos(t)}))
    return pd.concat(parts, ignore_index=True)


@pytest.fixture
def path(tmp_path):
    table(120, 80, 5, 100).to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv"


@given(
    lengths=st.lists(st.integers(40, 90), min_size=1, max_size=5),
    step=st.floats(1e-3, 1.0),
    empty=st.lists(st.integers(0, 39), max_size=5),
)
def test_runs_are_the_stretches_between_restarts(lengths, step, empty):
    time = np.concatenate([5.0 + step * np.arange(n) for n in lengths])
    time[empty] = np.nan
    wanted = np.repeat(np.arange(len(lengths)), lengths)
    found = runs_of(time)
    assert (found is None) if len(lengths) == 1 else np.array_equal(found, wanted)


def test_rows_that_are_mixed_up_are_no_restart():
    time = 0.01 * np.arange(200)
    time[[50, 51]] = time[[51, 50]]
    assert runs_of(time) is None
    assert runs_of(np.concatenate([time, time])) is None


def test_each_run_is_a_log_and_short_ones_are_left_out(path):
    logs = read_logs(path, "torque_pendulum", mapping=MAPPING)
    assert [log.path.name for log in logs] == [f"log.csv{MARK}{k}" for k in (0, 1, 3)]
    assert [len(log.channels["theta"]) for log in logs] == [120, 80, 100]
    assert logs[2].channels["theta"].value[0] == pytest.approx(1.3)
    assert any(note.endswith(f"never changes: log.csv{MARK}2") for note in logs[0].warnings)


def test_a_run_and_a_part_of_it_are_read_by_their_names(path):
    whole = read_log(f"{path}{MARK}1", MAPPING)
    assert len(whole.channels["theta"]) == 80
    part = read_log(f"{path}{MARK}1#t=0.2,1.3", MAPPING)
    assert part.path.name == f"log.csv{MARK}1#t=0.2,1.3"
    assert (part.start, part.stop) == (pytest.approx(0.2), pytest.approx(1.3))


def test_chosen_runs_of_a_command_line(path):
    args = argparse.Namespace(system="torque_pendulum", map=MAPPING, fill=None, episodes=(3, 0))
    _, logs = logs_of_command(args, [path], None)
    assert [log.path.name for log in logs] == [f"log.csv{MARK}3", f"log.csv{MARK}0"]


@pytest.mark.parametrize(
    ("name", "episodes", "message"),
    [
        ("log.csv#run=7", None, "has no run 7; it has 4, and runs count from 0"),
        ("log.csv#run=two", None, r'"#run=two" names no run of a log; write log\.csv#run=0'),
        ("log.csv", (1, 4), "has no run 4; it has 4 runs, 0 to 3"),
        ("log.csv", (2,), "too short"),
    ],
)
def test_what_is_no_run_is_refused(path, name, episodes, message):
    with pytest.raises(LogError, match=message):
        read_logs(path.with_name(name), "torque_pendulum", mapping=MAPPING, episodes=episodes)


def test_a_single_log_must_be_one_run(path):
    with pytest.raises(
        LogError, match=r"the log has 4 runs; give one of them, log\.csv#run=0 to log\.csv#run=3"
    ):
        read_log(path, MAPPING)


def test_a_file_with_the_mark_in_its_name_is_a_whole_log(path):
    other = path.with_name(f"a{MARK}1")
    other.write_text(path.read_text())
    assert split_run(other) == (other, None)


@pytest.mark.parametrize("at", [0.0, 500.0])
@pytest.mark.parametrize("rows", [1, 3])
def test_wrong_stamps_are_no_restart(at, rows):
    time = 0.01 * np.arange(400)
    time[200 : 200 + rows] = at + 0.001 * np.arange(rows)
    assert runs_of(time) is None


def test_a_clock_that_is_set_is_no_restart():
    time = 10.0 + 0.01 * np.arange(1000)
    time[800:] -= 0.5
    assert runs_of(time) is None


def test_rows_of_joints_below_each_other_are_no_runs(path):
    frame = pd.read_csv(path).iloc[:200]
    frame["joint"] = np.repeat([0, 1], [120, 80])
    frame.to_csv(path, index=False)
    with pytest.raises(LogError, match=r'"joint" says of which part .* write "where: \{joint: 0\}"'):
        read_logs(path, "torque_pendulum", mapping=MAPPING)


def test_a_run_without_a_changing_command_is_left_out(path):
    frame = pd.read_csv(path)
    frame.loc[120:199, "u"] = 0.5
    frame.to_csv(path, index=False)
    logs = read_logs(path, "torque_pendulum", mapping=MAPPING)
    assert [log.path.name for log in logs] == [f"log.csv{MARK}0", f"log.csv{MARK}3"]


def test_rows_that_an_array_was_never_filled_with_are_left_out(tmp_path):
    t = np.zeros(300)
    t[:200] = 0.02 * np.arange(200)
    np.savez(tmp_path / "log.npz", t=t, u=np.sin(t), q=np.sin(2 * t))
    (log,) = read_logs(tmp_path / "log.npz", "torque_pendulum", mapping=MAPPING)
    assert len(log.channels["theta"]) == 200


def test_clocks_with_different_numbers_of_runs_are_refused(tmp_path):
    table(120, 80, 100)[["t", "u"]].to_csv(tmp_path / "drive.csv", index=False)
    table(120, 100)[["t", "q"]].to_csv(tmp_path / "log.csv", index=False)
    channels = {name: dict(channel) for name, channel in MAPPING["channels"].items()}
    channels["torque"]["file"] = "drive.csv"
    with pytest.raises(LogError, match=r'different numbers of runs \("torque" has 3, "theta" has 2\)'):
        read_logs(tmp_path / "log.csv", "torque_pendulum", mapping={**MAPPING, "channels": channels})


def test_a_part_of_a_log_of_several_runs_is_refused(path):
    with pytest.raises(LogError, match="the log has 4 runs"):
        read_logs(f"{path}#t=0,1", "torque_pendulum", mapping=MAPPING)


def test_a_file_is_read_once_for_all_its_runs(path):
    with files_kept():
        whole = open_log(path)
        assert open_log(path) is whole
        assert open_log(path, {"": {"t"}}) is not whole
    assert open_log(path) is not whole
