"""Reading and writing of measured logs, and errors for bad logs."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.logs.recording import LogError, Recording, Series, read_log, write_log
from tests.full_disk import largest_file

CHANNELS = [("torque", "N m", "command"), ("theta", "rad", "measurement"), ("omega", "rad/s", "measurement")]


def sidecar(**changes) -> dict:
    content = {
        "system": "rod_pendulum",
        "time": {"column": "t", "unit": "s"},
        "channels": {
            "torque": {"column": "command", "unit": "N m", "kind": "command"},
            "theta": {"column": "theta", "unit": "rad", "kind": "measurement"},
            "omega": {"column": "omega", "unit": "rad/s", "kind": "measurement"},
        },
    }
    return content | changes


def table(rows: int = 100, step: float = 0.02) -> pd.DataFrame:
    t = step * np.arange(rows)
    return pd.DataFrame({"t": t, "command": np.sin(5 * t), "theta": np.cos(t), "omega": -np.sin(t)})


def save(folder: Path, frame: pd.DataFrame, content: dict | None = None) -> Path:
    path = folder / "log.csv"
    frame.to_csv(path, index=False)
    path.with_suffix(".yaml").write_text(
        yaml.safe_dump(sidecar() if content is None else content, sort_keys=False)
    )
    return path


def test_read_log_gives_the_bits_of_every_channel(tmp_path):
    frame = table()
    recording = read_log(save(tmp_path, frame), channels=CHANNELS)
    assert recording.system == "rod_pendulum"
    assert recording.names("command") == ("torque",)
    assert recording.names("measurement") == ("theta", "omega")
    np.testing.assert_array_equal(recording.channels["theta"].value, frame["theta"])
    np.testing.assert_array_equal(recording.channels["torque"].t, frame["t"])
    assert (recording.start, recording.stop) == (0.0, frame["t"].iloc[-1])


def test_read_log_converts_units_to_those_of_the_system(tmp_path):
    frame = table()
    content = sidecar(time={"column": "t", "unit": "ms"})
    content["channels"]["theta"]["unit"] = "deg"
    content["channels"]["omega"]["unit"] = "rpm"
    content["channels"]["torque"]["unit"] = "mN*m"
    path = save(tmp_path, frame.assign(t=frame["t"] * 1000), content)
    recording = read_log(path, channels=CHANNELS, allow_implausible=True)
    np.testing.assert_allclose(recording.channels["theta"].t, frame["t"])
    np.testing.assert_allclose(recording.channels["theta"].value, frame["theta"] * np.pi / 180)
    np.testing.assert_allclose(recording.channels["omega"].value, frame["omega"] * 2 * np.pi / 60)
    np.testing.assert_allclose(recording.channels["torque"].value, frame["command"] / 1000)
    assert [series.unit for series in recording.channels.values()] == ["N m", "rad", "rad/s"]


@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ns", 1e9)])
def test_times_that_are_dates_count_from_the_begin_of_the_log(tmp_path, unit, factor):
    frame = table()
    moved = frame.assign(
        t=(factor * (1_700_000_000.25 + frame["t"])).astype("int64" if factor > 1 else float)
    )
    moved.loc[10:20, "theta"] = np.nan
    path = save(tmp_path, moved, sidecar(time={"column": "t", "unit": unit}))
    recording = read_log(path, fill="hold")
    np.testing.assert_allclose(recording.channels["torque"].t, frame["t"] + 0.25, atol=1e-6)
    np.testing.assert_allclose(recording.unknown, [[0.45, 0.67]], atol=1e-6)
    assert "times count from 2023-11-14 22:13:20 UTC" in " ".join(recording.warnings)


def test_read_log_accepts_parquet_and_a_mapping_as_dict(tmp_path):
    frame = table()
    frame.to_parquet(tmp_path / "log.parquet")
    recording = read_log(tmp_path / "log.parquet", mapping=sidecar(), channels=CHANNELS)
    np.testing.assert_array_equal(recording.channels["omega"].value, frame["omega"])


def test_read_log_removes_repeated_samples_of_a_command(tmp_path):
    frame = table()
    frame["t_command"] = np.repeat(frame["t"].to_numpy()[::4], 4) + 0.001
    frame["command"] = np.repeat(frame["command"].to_numpy()[::4], 4)
    content = sidecar()
    content["channels"]["torque"]["time"] = "t_command"
    series = read_log(save(tmp_path, frame, content)).channels["torque"]
    np.testing.assert_array_equal(series.t, frame["t_command"][::4])
    # Zero-order hold: the sample of 0.001 s holds until just before 0.081 s.
    np.testing.assert_array_equal(series.hold(np.array([0.0, 0.08, 0.081])), series.value[[0, 0, 1]])


def test_between_keeps_the_command_that_holds_at_the_start():
    command = Series([0.0, 1.0, 2.0], [1.0, 2.0, 3.0], "V", "command")
    theta = Series([0.0, 1.0, 2.0], [0.0, 0.1, 0.2], "rad", "measurement")
    cut = Recording({"voltage": command, "theta": theta}).between(1.5, 2.0)
    assert cut.channels["voltage"].t.tolist() == [1.0, 2.0]
    assert cut.channels["theta"].t.tolist() == [2.0]


@pytest.mark.parametrize(("fill", "expected"), [("drop", [0, 3]), ("hold", [0, 0, 0, 3])])
def test_fill_drops_or_holds_missing_values(tmp_path, fill, expected):
    frame = table()
    values = np.arange(100.0)
    values[1:3] = np.nan
    series = read_log(save(tmp_path, frame.assign(theta=values)), fill=fill, allow_implausible=True).channels[
        "theta"
    ]
    assert series.value[: len(expected)].tolist() == expected


finite = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=25, deadline=None)
@given(data=st.data(), shared=st.booleans())
def test_write_log_and_read_log_keep_the_bits(tmp_path_factory, data, shared):
    times = st.sets(st.floats(0, 1e9), min_size=2, max_size=9)
    t = np.array(sorted(data.draw(times)))
    other = t if shared else np.array(sorted({t[0], *data.draw(times)}))
    draw = lambda n: np.array(data.draw(st.lists(finite, min_size=n, max_size=n)))  # noqa: E731
    channels = {
        "t": Series(other, draw(len(other)), "V", "command"),
        "theta": Series(t, draw(len(t)), "rad", "measurement"),
    }
    path = tmp_path_factory.mktemp("log") / "log.csv"
    write_log(path, Recording(channels, system="pendulum", meta={"seed": 3}))
    checks = {
        "min_samples": 1,
        "min_seconds": -np.inf,
        "allow_constant_command": True,
        "allow_implausible": True,
    }
    back = read_log(path, **checks)
    assert back.system == "pendulum"
    assert back.meta == {"seed": 3}
    for name, series in channels.items():
        np.testing.assert_array_equal(back.channels[name].t, series.t)
        np.testing.assert_array_equal(back.channels[name].value, series.value)
        assert (back.channels[name].unit, back.channels[name].kind) == (series.unit, series.kind)


def test_write_log_never_overwrites(tmp_path):
    path = save(tmp_path, table())
    before = path.read_bytes()
    with pytest.raises(LogError, match=r"log\.csv: exists"):
        write_log(path, read_log(path))
    assert path.read_bytes() == before
    assert sorted(file.name for file in tmp_path.iterdir()) == ["log.csv", "log.yaml"]


def frame_with(column: str, rows: list[int], value) -> pd.DataFrame:
    frame = table()
    frame[column] = frame[column].astype(object)
    frame.loc[rows, column] = value
    return frame


BAD_TABLES = {
    "missing column": (
        table().drop(columns="omega"),
        r'column "omega" is missing; the file has t, command, theta',
    ),
    "NaN": (frame_with("theta", [4, 7], np.nan), r'column "theta": 2 samples NaN.*line 6, 9;.*drop'),
    "infinite": (frame_with("omega", [0], np.inf), r'column "omega": 1 sample NaN or infinite.*line 2;'),
    "no time stamp": (
        frame_with("t", [9], np.nan),
        r'column "t": 1 sample without a time stamp, at line 11',
    ),
    "duplicate stamp": (
        frame_with("t", [9], 0.16),
        r'column "t": 1 sample with a duplicate time stamp, at line 11;',
    ),
    "going back": (
        frame_with("t", [9], 0.15),
        r'column "t": 1 sample earlier than the row before, at line 11;',
    ),
    "beginning again": (
        pd.concat([table(), table()]),
        r"the clock begins again at line 102: the log has 2 runs; give one of them, log.csv#run=0 to log.csv#run=1",
    ),
    "text": (frame_with("theta", [3], "12 deg"), r'column "theta": "12 deg" at line 5 is no number'),
    "too few": (table(10), r'channel "theta" is too short: 10 samples, at least 20'),
    "too short": (
        table(step=0.001),
        r"too short: all measurements together cover 0.099 s, .*check the unit of the time",
    ),
    "constant command": (table().assign(command=0.5), r'command "torque" is constant \(0.5 N m\)'),
    "no rows": (table(0), r"contains no data rows"),
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_read_log_refuses_bad_tables_with_place_and_advice(tmp_path, name):
    frame, message = BAD_TABLES[name]
    path = save(tmp_path, frame)
    with pytest.raises(LogError, match=message) as caught:
        read_log(path, channels=CHANNELS)
    assert str(path) in str(caught.value)


def channel(name: str, **changes) -> dict:
    content = sidecar()
    content["channels"][name] |= changes
    return content


BAD_SIDECARS = {
    "unknown unit": (channel("theta", unit="parsec"), r'column "theta": unknown unit "parsec"; known.* rad'),
    "wrong quantity": (
        channel("omega", unit="deg"),
        r'channel "omega".*measures angle, expected angular velocity',
    ),
    "time in metres": (sidecar(time={"column": "t", "unit": "m"}), r'unit "m" is not a unit of time'),
    "no time": ({k: v for k, v in sidecar().items() if k != "time"}, r'key "time" is missing'),
    "unknown key": (sidecar(sytem="x"), r'unknown key "sytem"'),
    "wrong kind": (channel("theta", kind="sensor"), r'kind "sensor" is none of command, measurement'),
    "kind of another": (
        channel("theta", kind="command"),
        r'"theta".*kind is command, but measurement in the system',
    ),
    "mixed units": (channel("theta", column="omega"), r'column "omega" has mixed units, rad and rad/s'),
    "list of units": (channel("theta", unit=["rad", "deg"]), r"one column has one unit"),
    "wrong system": (sidecar(system="pendulum"), r'of system "pendulum", asked for "rod_pendulum"'),
    "unknown system": (sidecar(system="arm"), r'unknown system "arm"; known: pendulum, rod_pendulum'),
    "not a mapping": (["theta"], r"expected keys and values"),
    "channel of no system": (
        sidecar(
            channels=sidecar()["channels"] | {"mass": {"column": "t", "unit": "s", "kind": "measurement"}}
        ),
        r'channel "mass".*the system has no such channel; it has torque, theta, omega',
    ),
    "no command": (
        sidecar(channels={"theta": sidecar()["channels"]["theta"]}),
        r"no command channel is mapped; map at least one of: torque",
    ),
}


@pytest.mark.parametrize("name", BAD_SIDECARS)
def test_read_log_refuses_bad_sidecars_with_place_and_advice(tmp_path, name):
    content, message = BAD_SIDECARS[name]
    path = save(tmp_path, table(), content)
    with pytest.raises(LogError, match=message) as caught:
        read_log(path, system="rod_pendulum", channels=CHANNELS, systems=["pendulum", "rod_pendulum"])
    assert "log.yaml" in str(caught.value)


def test_read_log_refuses_a_unit_that_contradicts_the_header(tmp_path):
    frame = table().rename(columns={"theta": "theta [deg]"})
    path = save(tmp_path, frame, channel("theta", column="theta [deg]"))
    with pytest.raises(LogError, match="mixed units, the header says deg, the mapping says rad"):
        read_log(path)


def test_read_log_refuses_a_time_unit_that_contradicts_the_header(tmp_path):
    frame = table().rename(columns={"t": "t [ms]"})
    path = save(tmp_path, frame, sidecar(time={"column": "t [ms]", "unit": "s"}))
    with pytest.raises(
        LogError, match=r'column "t \[ms\]": mixed units, the header says ms, the mapping says s'
    ):
        read_log(path)


def test_read_log_refuses_times_in_two_units(tmp_path):
    frame = table()
    frame["t_command"] = frame["t"] * 1000 + 1e6
    path = save(tmp_path, frame, channel("torque", time="t_command"))
    with pytest.raises(LogError, match=r'command "torque".*lies outside the measurements'):
        read_log(path)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("log.csv", "", "first row is empty"),
        ("log.csv", "t,theta,theta\n0,1,2\n", 'column "theta" is there 2 times'),
        ("log.csv", '"' + 200_000 * "x" + "\n", "not readable as csv: field larger"),
        (
            "log.csv",
            "t,command,theta,omega\n0,1,2,3\n1,5,2,3,4\n",
            r"line 3 has \d+ cells and the header has 4 names",
        ),
        ("log.txt", "1 2", "is one column; separate the columns"),
        ("log.docx", "1 2", 'format ".docx" is not known; known: .csv'),
        ("log.parquet", "nonsense", "not readable as parquet"),
    ],
)
def test_read_log_refuses_damaged_files(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(LogError, match=message):
        read_log(tmp_path / name, mapping=sidecar())


def test_read_log_names_a_missing_file_or_sidecar(tmp_path):
    with pytest.raises(LogError, match=r"absent\.csv: no such file"):
        read_log(tmp_path / "absent.csv")
    table().to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(LogError, match=r"no sidecar .*log.yaml"):
        read_log(tmp_path / "log.csv")


def test_read_log_refuses_a_folder(tmp_path):
    with pytest.raises(LogError, match=r"the folder contains no log; known are .csv"):
        read_log(tmp_path)


def test_write_log_leaves_no_files_after_a_failure(tmp_path):
    """The limit of the file size allows the small sidecar, but only the first 4 kB of the log."""
    t = np.arange(2000) / 7
    recording = Recording({"theta": Series(t, np.sin(t), "rad", "measurement")})
    with largest_file(4096), pytest.raises(OSError, match="too large"):
        write_log(tmp_path / "log.csv", recording)
    assert list(tmp_path.iterdir()) == []
    write_log(tmp_path / "log.csv", recording)


def test_read_log_accepts_empty_cells_at_the_end_of_rows(tmp_path):
    path = save(tmp_path, table())
    header, *rows = path.read_text().splitlines()
    plain = read_log(path)
    path.write_text("\n".join([header, *(row + ",," for row in rows)]))
    trailing = read_log(path)
    np.testing.assert_array_equal(trailing.channels["omega"].value, plain.channels["omega"].value)


def test_read_log_refuses_a_column_without_values(tmp_path):
    frame = table()
    frame["command"] = np.nan
    with pytest.raises(LogError, match='channel "torque" is too short: 0 samples'):
        read_log(save(tmp_path, frame), fill="drop")


def test_one_of_several_commands_may_be_constant(tmp_path):
    """In a motion of one joint, the goals of the others stay; a log in which nothing is commanded is refused."""
    content = sidecar()
    content["channels"]["other"] = {"column": "other", "unit": "N m", "kind": "command"}
    frame = table().assign(other=0.25)
    frame.to_csv(tmp_path / "a.csv", index=False)
    assert np.ptp(read_log(tmp_path / "a.csv", content).channels["other"].value) == 0
    frame.assign(command=0.5).to_csv(tmp_path / "b.csv", index=False)
    with pytest.raises(LogError, match=r'command "torque" is constant'):
        read_log(tmp_path / "b.csv", content)


@pytest.mark.parametrize(
    ("name", "size", "read"), [("command", 30.0, True), ("command", 3000.0, False), ("theta", 30.0, False)]
)
def test_a_command_may_answer_a_new_goal_with_many_times_what_it_usually_is(tmp_path, name, size, read):
    path = save(tmp_path, frame_with(name, [40], size))
    if read:
        assert read_log(path, channels=CHANNELS).channels["torque"].value.max() == size
        return
    with pytest.raises(LogError, match=f'column "{name}": 1 sample far from all others'):
        read_log(path, channels=CHANNELS)


def test_rows_that_were_stamped_at_once_after_a_pause_are_all_kept(tmp_path):
    frame = table()
    assert frame["t"].iloc[61] - frame["t"].iloc[60] == pytest.approx(0.02)
    # Six rows wait for the reader, which stamps them in whole milliseconds.
    frame.loc[50:55, "t"] = frame["t"].iloc[55] + 0.001 * np.array([0, 0, 0, 1, 1, 1])
    recording = read_log(save(tmp_path, frame), channels=CHANNELS)
    theta = recording.channels["theta"]
    np.testing.assert_array_equal(theta.value, frame["theta"])
    assert (np.diff(theta.t) > 0.0).all()
    np.testing.assert_allclose(theta.t, frame["t"], rtol=0.0, atol=1e-5)
    assert any("came together" in warning for warning in recording.warnings)
