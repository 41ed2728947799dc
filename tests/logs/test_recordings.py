"""Paths that name recordings: files, folders of logs, and folders that are one recording."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import deepkoco
from deepkoco.cli.command_line import main
from deepkoco.excitation.record import record
from deepkoco.logs import LogError, read_log, read_logs, write_log
from deepkoco.logs.formats import open_log
from deepkoco.logs.formats.recordings import recordings
from deepkoco.systems import Channel, Parameter, System, load_system
from deepkoco.unit import make_unit

SYSTEM = "torque_pendulum"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Three logs with sidecars, named so that their order as text is not that of their numbers."""
    target = tmp_path_factory.mktemp("unit") / "logs"
    for number, seed in ((10, 1), (9, 2), (2, 3)):
        log = record(make_unit(SYSTEM, seed=seed), "prbs", 3.0, clock="simulated", seed=seed)
        write_log(target / f"run{number}.csv", log)
    return target


def wide(path: Path, joints=("shoulder", "elbow"), seed: int = 0, **rename: str) -> Path:
    t = 0.02 * np.arange(150)
    columns = {"t": t}
    for k, joint in enumerate(joints):
        columns[f"goal_{joint}"] = np.sin((k + 1) * t + seed)
        columns[f"q_{joint}"] = 0.9 * np.sin((k + 1) * t + seed - 0.1)
    path.parent.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(columns).rename(columns=rename).to_csv(path, index=False)
    return path


CHANNELS = [
    ("shoulder", "rad", "command"),
    ("elbow", "rad", "command"),
    ("q_shoulder", "rad", "measurement"),
    ("q_elbow", "rad", "measurement"),
    ("dq_shoulder", "rad/s", "measurement"),
]


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(numbers=st.lists(st.integers(0, 10**6), min_size=1, max_size=6, unique=True))
def test_logs_of_a_folder_come_in_the_order_of_their_numbers(tmp_path_factory, numbers):
    place = tmp_path_factory.mktemp("many")
    for number in numbers:
        (place / f"run_{number}.csv").write_text("t,x\n0,1\n")
    assert [path.name for path in recordings([place])] == [f"run_{n}.csv" for n in sorted(numbers)]


def test_a_folder_is_searched_with_its_folders_and_without_other_files(tmp_path):
    for name in (
        "a.csv",
        "sub/b.parquet",
        "sub/deeper/c.mcap",
        ".hidden/d.csv",
        "notes.txt",
        "a.yaml",
        "report.json",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("{}")
    found = [path.relative_to(tmp_path).as_posix() for path in recordings([tmp_path, tmp_path / "a.csv"])]
    assert found == ["a.csv", "sub/b.parquet", "sub/deeper/c.mcap"]


@pytest.mark.parametrize(
    ("text", "log"),
    [
        ("t\tx\n0.0\t1.0\n", True),
        ("t x\n0.0 1.0\n", True),
        ("t;x\n0,0;1,0\n", True),
        ("shoulder\nelbow\n", False),
        ("Read me, please\nThe log, of Monday\n", False),
        ("Read me, please\nMonday, 4\nand Tuesday\n", False),
        ("stamp,q\n2026-01-02T10:00:00.5Z,1.5\n2026-01-02T10:00:00.6Z,1.6\n", True),
        ("stamp;mode\n10:00:00,5;auto\n10:00:00,6;\n", True),
        ('t,q\n0.0,"[0.1, nan]"\n', True),
        ("t\tq\tu\n0.0\t[0.1, 0.2]\t[1, 2]\n", True),
        ("t,mode\n0.0,auto\n0.1,off\n", True),
        ("t,x\r0,1\r1,2\r", True),
        ("epoch 1, of 2\n  0%|  | 0/2\r 50%|# | 1/2\r100%|##| 2/2\n", False),
        ("loss|step\r12|13\n12|14\r\n", False),
    ],
)
def test_a_text_in_a_folder_is_a_log_if_it_begins_with_names_and_numbers(tmp_path, text, log):
    (tmp_path / "a.txt").write_text(text)
    (tmp_path / "b.tsv").write_text("t\tx\n0\t1\n")
    assert [path.name for path in recordings([tmp_path])] == (["a.txt", "b.tsv"] if log else ["b.tsv"])
    if log:
        assert len(open_log(tmp_path / "a.txt").table("").frame) >= 1


def test_a_pair_of_commands_and_states_is_one_recording(tmp_path):
    for name in ("first", "second"):
        wide(tmp_path / name / "command.csv")
        wide(tmp_path / name / "state.csv")
    assert recordings([tmp_path]) == (tmp_path / "first", tmp_path / "second")
    (tmp_path / "second" / "command.csv").rename(tmp_path / "second" / "other.csv")
    assert [path.name for path in recordings([tmp_path])] == ["first", "other.csv", "state.csv"]


def test_a_file_that_a_sidecar_names_is_no_log_of_its_own(tmp_path):
    wide(tmp_path / "state.csv", q_elbow="angle")
    wide(tmp_path / "drive.csv")
    time = {"column": "t", "unit": "s"}
    channels = {
        "theta": {"column": "angle", "unit": "rad", "kind": "measurement"},
        "goal": {"file": "drive.csv", "column": "goal_elbow", "unit": "rad", "kind": "command"},
    }
    (tmp_path / "state.yaml").write_text(yaml.safe_dump({"time": time, "channels": channels}))
    assert recordings([tmp_path]) == (tmp_path / "state.csv",)
    assert set(read_log(tmp_path).channels) == {"theta", "goal"}  # the folder contains one recording


@pytest.mark.parametrize("name", ["empty", "missing"])
def test_a_folder_without_logs_is_refused(tmp_path, name):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "notes.txt").write_text("x")
    message = "the folder contains no log; known are .csv" if name == "empty" else "no such file or folder"
    with pytest.raises(LogError, match=message):
        recordings([tmp_path / name])


def test_the_sidecar_of_a_folder_holds_for_the_logs_in_it(tmp_path):
    for k in range(2):
        wide(tmp_path / "logs" / f"{k}.csv", seed=k)
    channels = {
        "goal": {"column": "goal_elbow", "unit": "rad", "kind": "command"},
        "theta": {"column": "q_elbow", "unit": "rad", "kind": "measurement"},
    }
    content = {"time": {"column": "t", "unit": "s"}, "channels": channels}
    (tmp_path / "logs.yaml").write_text(yaml.safe_dump(content))
    assert set(read_log(tmp_path / "logs" / "1.csv").channels) == {"goal", "theta"}
    del channels["goal"]
    content["channels"] = {
        **channels,
        "effort": {"column": "goal_shoulder", "unit": "rad", "kind": "command"},
    }
    (tmp_path / "logs" / "1.yaml").write_text(yaml.safe_dump(content))
    assert set(read_log(tmp_path / "logs" / "1.csv").channels) == {"effort", "theta"}  # its own comes first


def test_columns_with_the_names_of_the_channels_need_no_sidecar(tmp_path):
    path = wide(tmp_path / "a.csv")
    recording = read_log(path, channels=CHANNELS)
    assert set(recording.channels) == {"shoulder", "elbow", "q_shoulder", "q_elbow"}
    table = pd.read_csv(path)
    np.testing.assert_array_equal(recording.channels["elbow"].value, table["goal_elbow"])
    np.testing.assert_array_equal(recording.channels["q_elbow"].value, table["q_elbow"])
    assert "no sidecar" in recording.warnings[0]


@pytest.mark.parametrize(
    "rename",
    [
        {"t": "time_ms"},  # the unit of the time is not certain
        {"goal_shoulder": "a", "goal_elbow": "b"},  # no command has its name
        {"goal_shoulder": "shoulder", "q_elbow": "cmd_shoulder"},  # two columns for one command
        {"q_shoulder": "q_shoulder [deg]", "q_elbow": "x"},
    ],
)
def test_uncertain_names_need_a_sidecar(tmp_path, rename):
    path = wide(tmp_path / "a.csv", **rename)
    with pytest.raises(LogError, match=r"no sidecar .* write one with deepkoco inspect"):
        read_log(path, channels=CHANNELS)


def test_wrong_names_of_joints_are_answered_with_the_nearest(tmp_path):
    path = wide(tmp_path / "a.csv")
    content = {
        "time": {"column": "t", "unit": "s"},
        "channels": {
            "shoulder": {"column": "goal_shoulder", "unit": "rad", "kind": "command"},
            "q_sholder": {"column": "q_shoulder", "unit": "rad", "kind": "measurement"},
        },
    }
    with pytest.raises(LogError, match=r'"q_sholder" .* no such channel; did you mean q_shoulder'):
        read_log(path, content, channels=CHANNELS)
    content["channels"]["q_shoulder"] = {**content["channels"].pop("q_sholder"), "column": "q_sholder"}
    with pytest.raises(LogError, match=r'column "q_sholder" is missing; did you mean q_shoulder'):
        read_log(path, content, channels=CHANNELS)


@pytest.mark.parametrize("scale", [1.0, -1.0, 0.5])
def test_scale_and_offset_map_a_sensor_to_the_model(tmp_path, scale):
    """The offset is in the unit of the column, and is added after the scale."""
    path = wide(tmp_path / "a.csv")
    entry = {"column": "q_elbow", "unit": "deg", "kind": "measurement", "scale": scale, "offset": 90.0}
    content = {"time": {"column": "t", "unit": "s"}, "channels": {"theta": entry}}
    value = read_log(path, content).channels["theta"].value
    np.testing.assert_allclose(value, np.radians(scale * pd.read_csv(path)["q_elbow"] + 90.0), rtol=1e-12)
    entry["offset"] = "much"
    with pytest.raises(LogError, match="offset: 'much' is not a finite number in deg"):
        read_log(path, content)


def test_read_logs_takes_recordings_paths_and_folders(folder):
    names = ["run2.csv", "run9.csv", "run10.csv"]
    assert [log.path.name for log in read_logs(folder, SYSTEM)] == names
    one = read_log(folder / "run9.csv")
    assert read_logs(one, SYSTEM) == [one]
    mixed = read_logs([one, str(folder / "run2.csv"), folder], SYSTEM)
    assert [log.path.name for log in mixed] == ["run9.csv", "run2.csv", *names]


def test_fit_and_diagnose_of_the_package_take_folders(folder, tmp_path):
    found = deepkoco.fit(folder, SYSTEM, ["viscous"])
    assert found.logs == ("run2.csv", "run9.csv", "run10.csv")
    again = deepkoco.fit([read_log(path) for path in recordings([folder])], SYSTEM, ["viscous"])
    assert found.estimates["viscous"] == again.estimates["viscous"]
    diagnosis = deepkoco.diagnose(str(folder / "run2.csv"), SYSTEM, healthy=[folder / "run9.csv"], window=2.5)
    assert diagnosis.verdict == "insufficient"
    assert diagnosis.save(tmp_path / "report") == tmp_path / "report" / "report.html"
    assert (tmp_path / "report" / "report.json").is_file()


def test_identify_takes_a_folder_on_the_command_line(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert (
        main(["identify", str(folder), "--system", SYSTEM, "--parameters", "viscous", "--out", str(out)]) == 0
    )
    assert "run10.csv" in (out / "identify.json").read_text()
    empty = tmp_path / "empty"
    empty.mkdir()
    assert main(["identify", str(empty), "--system", SYSTEM]) == 2
    assert "the folder contains no log" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["a", "3-1", "1-", "-2", "1,,2", "0-99999999"])
def test_episodes_that_are_no_list_are_refused(folder, text, capsys):
    with pytest.raises(SystemExit):
        main(["identify", str(folder), "--system", SYSTEM, f"--episodes={text}"])
    assert "episode" in capsys.readouterr().err


PENDULUM = """
<mujoco model="swing"><worldbody><body><joint name="pivot" axis="0 1 0"/>
  <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.5" mass="1"/></body></worldbody>
<actuator><motor name="drive" joint="pivot" gear="2"/></actuator></mujoco>
"""


def swinging(folder, **columns):
    t = np.arange(0.0, 3.0, 0.01)
    values = {"time_s": t, "pivot_angle_deg": 40.0 * np.sin(3.0 * t), "drive_cmd": np.cos(2.0 * t)}
    frame = pd.DataFrame(values | {name: np.sin(f * t) for name, f in columns.items()})
    frame.to_csv(folder / "log.csv", index=False)
    (folder / "swing.xml").write_text(PENDULUM)
    return folder / "log.csv", load_system(folder / "swing.xml")


def test_a_log_without_a_sidecar_is_read_where_its_names_leave_no_doubt(tmp_path):
    log, system = swinging(tmp_path)
    (recording,) = read_logs([log], system)
    np.testing.assert_allclose(recording.channels["q_pivot"].value.max(), np.deg2rad(40.0), rtol=1e-3)
    assert set(recording.channels) == {"q_pivot", "drive"}
    assert recording.warnings[0].startswith(
        "no sidecar: q_pivot = pivot_angle_deg [deg], drive = drive_cmd [1]"
    )
    assert "deepkoco inspect" in recording.warnings[0]


@pytest.mark.parametrize(("limit", "taken"), [(2.0, True), (2000.0, False)])
def test_a_motor_without_a_unit_takes_the_number_of_its_amperes(tmp_path, limit, taken):
    log, _ = swinging(tmp_path)
    frame = pd.read_csv(log)
    frame["drive_cmd_mA"] = 1000.0 * frame.pop("drive_cmd")
    frame.to_csv(log, index=False)
    (tmp_path / "swing.xml").write_text(PENDULUM.replace("gear=", f'ctrlrange="-{limit} {limit}" gear='))
    system = load_system(tmp_path / "swing.xml")
    if not taken:  # the limits of this model are in mA as well
        with pytest.raises(LogError, match="no name says that drive_cmd_mA is in 1"):
            read_logs([log], system)
        return
    (recording,) = read_logs([log], system)
    np.testing.assert_allclose(recording.channels["drive"].value, frame["drive_cmd_mA"] / 1000.0)
    assert "drive_cmd_mA times 0.001 is drive" in recording.warnings[0]


class Lever(System):
    """A lever whose joint has no name."""

    joint_units = "rad"
    parameters = (Parameter("inertia", 0.1, "kg m2", 0.01, 1.0, 0.01, "of the lever"),)
    commands = (Channel("torque", "N m", "command", -2.0, 2.0),)
    measurements = (Channel("theta", "rad", "measurement", noise_sd=1e-3),)

    def accelerations(self, p):
        return lambda motion: ((motion.efforts[0] + motion.load(0)) / p["inertia"],)


@pytest.mark.parametrize(("name", "sure"), [("theta [deg]", True), ("theta", False)])
def test_a_system_without_names_of_joints_needs_no_sidecar_where_units_are_told(tmp_path, name, sure):
    t = np.arange(0.0, 3.0, 0.01)
    columns = {"time_s": t, name: 40.0 * np.sin(3.0 * t), "torque_mNm": -63.0 * np.sin(3.0 * t)}
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    if not sure:
        with pytest.raises(LogError, match=r"no sidecar .*theta.* with deepkoco inspect .*--system"):
            read_logs([tmp_path / "log.csv"], Lever())
        return
    (recording,) = read_logs([tmp_path / "log.csv"], Lever())
    np.testing.assert_allclose(recording.channels["theta"].value, np.deg2rad(columns[name]))
    np.testing.assert_allclose(recording.channels["torque"].value, 1e-3 * columns["torque_mNm"])


def test_a_log_whose_command_is_not_sure_needs_a_sidecar(tmp_path):
    log, system = swinging(tmp_path)
    pd.read_csv(log).rename(columns={"drive_cmd": "a"}).assign(b=1.0).to_csv(log, index=False)
    with pytest.raises(
        LogError, match=r"no sidecar .*\(no column .*drive.*\); write one with deepkoco inspect"
    ):
        read_logs([log], system)
    with pytest.raises(LogError, match=r"no sidecar .*other.yaml"):
        read_logs([log], system, mapping=tmp_path / "other.yaml")


def test_a_unit_that_only_the_values_tell_needs_a_sidecar(tmp_path):
    log, system = swinging(tmp_path)
    pd.read_csv(log).rename(columns={"pivot_angle_deg": "pivot_angle"}).to_csv(log, index=False)
    with pytest.raises(LogError, match=r"no name says that pivot_angle is in deg"):
        read_logs([log], system)


@pytest.mark.parametrize(
    "name", ["drive_vel_cmd", "drive_target", "drive_current", "drive_torque_nm", "drive_position_cmd"]
)
def test_what_may_be_another_quantity_is_no_command_for_sure(tmp_path, name):
    log, system = swinging(tmp_path)
    pd.read_csv(log).rename(columns={"drive_cmd": name}).to_csv(log, index=False)
    with pytest.raises(LogError, match="no sidecar"):
        read_logs([log], system)


def test_percent_of_an_actuator_is_not_its_command_for_sure(tmp_path):
    log, system = swinging(tmp_path)
    frame = pd.read_csv(log)
    frame["drive_cmd"] *= 100.0 * system.commands[0].high
    frame.to_csv(log, index=False)
    with pytest.raises(LogError, match="no name says that drive_cmd is in 1"):
        read_logs([log], system)


def test_logs_beside_one_with_a_sidecar_need_one_too(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    log, system = swinging(tmp_path)
    for name in ("a", "b"):
        (folder / f"{name}.csv").write_bytes(log.read_bytes())
    assert len(read_logs([folder], system)) == 2
    column = {"column": "pivot_angle_deg", "unit": "deg", "kind": "measurement", "scale": -1}
    command = {"column": "drive_cmd", "unit": "1", "kind": "command"}
    content = {"time": {"column": "time_s", "unit": "s"}, "channels": {"q_pivot": column, "drive": command}}
    (folder / "b.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(LogError, match=r"b\.csv has one"):
        read_logs([folder], system)
