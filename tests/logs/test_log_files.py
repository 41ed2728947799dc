"""Logs in MCAP files and bags: topics, fields, joints, clocks and errors."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepkoco.logs import LogError, read_log
from deepkoco.logs.formats import open_log
from deepkoco.logs.formats.fields import TopicColumns
from tests.logs.log_writers import (
    START_NS,
    WRITERS,
    mapping,
    write_csv,
    write_json_mcap,
    write_ros1_bag,
    write_ros_mcap,
)

CHANNELS = [("torque", "N m", "command"), ("theta", "rad", "measurement"), ("omega", "rad/s", "measurement")]


def signals(rows: int = 100) -> dict[str, np.ndarray]:
    t = 0.02 * np.arange(rows)
    return {"t": t, "torque": np.sin(5 * t), "theta": np.cos(3 * t), "omega": -3 * np.sin(3 * t)}


def needs_ros(name: str) -> None:
    if name != "json.mcap":
        pytest.importorskip("rosbags")


@pytest.mark.parametrize("name", WRITERS)
def test_read_log_gives_the_same_values_in_every_format(tmp_path, name):
    needs_ros(name)
    wanted = signals()
    recording = read_log(WRITERS[name](tmp_path / name, wanted), mapping(), channels=CHANNELS)
    for channel in ("torque", "theta", "omega"):
        np.testing.assert_array_equal(recording.channels[channel].value, wanted[channel])
        # The file's first message is the command of t = 0; stamps are whole nanoseconds.
        np.testing.assert_allclose(recording.channels[channel].t, wanted["t"], atol=2e-9)


def test_read_log_uses_the_time_received_of_a_channel(tmp_path):
    path = write_json_mcap(tmp_path / "a.mcap", signals())
    received = read_log(path, mapping(time="received")).channels["theta"].t
    np.testing.assert_allclose(received, signals()["t"] + 0.002, atol=2e-9)


def test_read_log_finds_a_joint_by_name_and_an_element_by_number(tmp_path):
    path = write_json_mcap(tmp_path / "a.mcap", signals())
    content = mapping()
    content["channels"]["theta"] |= {"joint": None, "field": "position[shoulder]"}
    by_name = read_log(path, content).channels["theta"].value
    np.testing.assert_array_equal(by_name, signals()["theta"])
    content["channels"]["theta"]["field"] = "position[0]"  # the joints change places
    by_number = read_log(path, content, allow_implausible=True).channels["theta"].value
    np.testing.assert_array_equal(by_number[::2], 0.5)


def test_topic_columns_skip_messages_of_other_joints():
    columns = TopicColumns("", 0)
    for k in range(4):
        columns.add(k, {"name": ["a" if k % 2 else "b"], "position": [float(k)]})
    table = columns.table()
    assert table.absent["position[a]"].tolist() == [True, False, True, False]
    assert table.frame["position[a]"].dropna().tolist() == [1.0, 3.0]


def test_topic_columns_convert_nested_fields_and_stamps():
    columns = TopicColumns("", 10**18)
    message = {
        "joints": {"names": ["x", "y"], "position": [1, 2]},
        "at": {"sec": 10**9 + 1, "nsec": 500_000_000},
    }
    message |= {"image": list(range(500)), "flag": True}
    columns.add(10**18, message)
    columns.add(10**18 + 10**9, message)
    table = columns.table()
    assert table.frame["joints.position[y]"].tolist() == [2.0, 2.0]
    assert table.frame["at"].tolist() == [1.5, 1.5]
    assert table.frame["flag"].tolist() == [1.0, 1.0]
    assert table.left_out == {"image": "500 elements"}
    one = TopicColumns("", 0, ["joints.position[1]", "image[499]", "absent[0]"])
    one.add(0, message)
    assert one.table().frame.iloc[0].to_dict() == {
        "received": 0.0,
        "joints.position[1]": 2.0,
        "image[499]": 499.0,
    }


def test_read_log_accepts_recordings_of_our_own_runtimes(tmp_path):
    from deepkoco.graph import write_episodes
    from deepkoco.graph.episodes.episode import Episode
    from deepkoco.graph.episodes.storage.description import RecordedNode
    from deepkoco.graph.model.graph import Graph

    graph = Graph(
        [RecordedNode("sensor", 50, kind="Sensor"), RecordedNode("agent", 50, kind="Agent")], [], "agent"
    )
    wanted, episodes = signals(), []
    for shift in (0.0, 1.0):
        start = wanted["t"]
        outputs = {
            "sensor": np.stack([wanted["theta"] + shift, wanted["omega"]], 1),
            "agent": wanted["torque"][:-1, None],
        }
        times = {"sensor": start, "agent": start}
        episodes.append(Episode(times, times, outputs, {}, {}, {}))
    path = write_episodes(tmp_path / "run.mcap", graph, episodes)
    content = {
        "where": {"episode": 1},
        "channels": {
            "torque": {"topic": "/node/agent", "field": "output[0]", "unit": "N m", "kind": "command"},
            "theta": {"topic": "/node/sensor", "field": "output[0]", "unit": "rad", "kind": "measurement"},
        },
    }
    recording = read_log(path, content)
    np.testing.assert_array_equal(recording.channels["theta"].value, wanted["theta"] + 1.0)
    np.testing.assert_array_equal(recording.channels["theta"].t, wanted["t"])
    np.testing.assert_array_equal(recording.channels["torque"].value, wanted["torque"][:-1])
    del content["where"]
    with pytest.raises(LogError, match=r"the log has 2 runs; give one of them, run.mcap#run=0"):
        read_log(path, content)


def test_read_log_joins_files_with_different_clocks(tmp_path):
    wanted = signals()
    path = write_json_mcap(tmp_path / "state.mcap", wanted)
    epoch = START_NS / 1e9
    write_csv(tmp_path / "drive.csv", {"when": wanted["t"] + epoch - 7.0, "mNm": 1e3 * wanted["torque"]})
    content = mapping()
    time = {"column": "when", "unit": "s", "offset": 7.0}
    drive = {"file": "drive.csv", "column": "mNm", "unit": "mN m", "kind": "command", "time": time}
    content["channels"] = {n: content["channels"][n] for n in ("theta", "omega")} | {"torque": drive}
    recording = read_log(path, content, channels=CHANNELS)
    np.testing.assert_allclose(recording.channels["torque"].value, wanted["torque"])
    np.testing.assert_allclose(recording.channels["torque"].t, wanted["t"], atol=1e-6)  # float64 of 1.7e9 s


def test_read_log_accepts_dates_as_times(tmp_path):
    wanted = signals()
    dates = pd.to_datetime(1_700_000_000 + wanted["t"], unit="s")
    path = write_csv(tmp_path / "a.csv", {**wanted, "t": [d.isoformat() for d in dates]})
    content = {
        "time": {"column": "t", "unit": "iso8601"},
        "channels": {
            "torque": {"column": "torque", "unit": "N m", "kind": "command"},
            "theta": {"column": "theta", "unit": "rad", "kind": "measurement"},
        },
    }
    t = read_log(path, content).channels["theta"].t
    np.testing.assert_allclose(t - t[0], wanted["t"], atol=1e-6)
    frame = pd.DataFrame({**wanted, "t": dates})
    frame.to_parquet(tmp_path / "a.parquet")
    content["time"]["unit"] = "s"
    np.testing.assert_allclose(read_log(tmp_path / "a.parquet", content).channels["theta"].t, t, atol=1e-6)


@pytest.mark.parametrize("cut", [0.3, 0.7, 0.98])
@pytest.mark.parametrize("name", WRITERS)
def test_read_log_refuses_a_truncated_file(tmp_path, name, cut):
    needs_ros(name)
    path = WRITERS[name](tmp_path / name, signals())
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
    file.write_bytes(file.read_bytes()[: int(cut * file.stat().st_size)])
    with pytest.raises(LogError) as caught:
        read_log(path, mapping())
    assert str(path) in str(caught.value)
    assert "Traceback" not in str(caught.value)


def test_read_log_names_a_missing_topic_field_or_joint(tmp_path):
    path = write_json_mcap(tmp_path / "a.mcap", signals())
    for change, message in (
        ({"topic": "/joint_state"}, 'no topic "/joint_state"'),
        (
            {"field": "positions"},
            r'field "positions\[shoulder\]" is missing; did you mean position\[shoulder\] .*the topic has',
        ),
        ({"joint": "wrist"}, r'field "position\[wrist\]" is missing'),
        ({"field": "position..x"}, "is not a path such as joints.position"),
        ({"time": "header.time"}, r'field "header.time" is missing'),
        ({"column": "theta"}, "give either a column, or a topic and a field"),
    ):
        content = mapping()
        content["channels"]["theta"] |= change
        with pytest.raises(LogError, match=message):
            read_log(path, content)


def test_read_log_names_the_extra_of_a_missing_library(tmp_path, monkeypatch):
    pytest.importorskip("rosbags")
    bag = write_ros1_bag(tmp_path / "a.bag", signals())
    mcap = write_ros_mcap(tmp_path / "a.mcap", signals())
    monkeypatch.setitem(sys.modules, "rosbags", None)
    for path in (bag, mcap):
        with pytest.raises(LogError, match='pip install "rosbags'):
            read_log(path, mapping())


def test_read_log_accepts_a_single_database_of_a_bag(tmp_path):
    pytest.importorskip("rosbags")
    folder = WRITERS["ros2_sqlite"](tmp_path / "bag", signals())
    database = next(folder.glob("*.db3"))
    shutil.copy(database, tmp_path / "only.db3")
    recording = read_log(tmp_path / "only.db3", mapping())
    np.testing.assert_array_equal(recording.channels["theta"].value, signals()["theta"])


def test_open_log_reads_semicolons_with_decimal_commas(tmp_path):
    path = tmp_path / "a.csv"
    pd.DataFrame(signals()).to_csv(path, index=False, sep=";", decimal=",")
    log = open_log(path)
    np.testing.assert_array_equal(log.values("", "theta"), signals()["theta"])
    assert "decimal commas" in log.notes[0]


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"t,\xb0\n1,2\n", "byte 0xb0 in line 1; save the file as UTF-8"),
        ("t,x\n1,2\n".encode("utf-16"), "in UTF-16; save it as UTF-8"),
        (b"0,1\n1,2\n", "first row contains numbers"),
        (b"t theta\n1 2 3\n", "is one column; separate the columns"),
        (b"t,x\n1,\x002\n", "zero byte in line 2"),
    ],
)
def test_open_log_refuses_text_without_a_table(tmp_path: Path, raw: bytes, message: str) -> None:
    (tmp_path / "a.csv").write_bytes(raw)
    with pytest.raises(LogError, match=message):
        open_log(tmp_path / "a.csv")
