"""Logs of PACE, SAGE and BAM, written here as those projects write them, and read back."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from deepkoco.logs import LogError, read_log
from deepkoco.logs.formats import open_log
from deepkoco.logs.formats.recordings import recordings

T = np.arange(400) / 200.0
GOAL = np.stack([np.sin(3 * T), 0.5 * np.cos(2 * T)], axis=1)
ANGLE = 0.9 * np.roll(GOAL, 4, axis=0)


def write_pace(path: Path, **more) -> Path:
    content = {"time": T, "dof_pos": ANGLE, "des_dof_pos": GOAL}
    tensors = {name: torch.tensor(value, dtype=torch.float32) for name, value in content.items()}
    torch.save({**tensors, **more}, path)
    return path


def write_sage(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "joint_list.txt").write_text("Rotation\n Pitch\n")
    with (folder / "control.csv").open("w") as file:
        file.write("type,timestamp,positions\n")
        for t, goal in zip(T, GOAL, strict=True):
            file.write(f'CONTROL,{1e6 * t + 5.0},"{goal.tolist()}"\n')
    with (folder / "state_motor.csv").open("w") as file:
        file.write("type,timestamp,positions,velocities,torques\n")
        for t, angle in zip(T, ANGLE, strict=True):
            file.write(f'STATE_MOTOR,{1e6 * t + 1.0},"{angle.tolist()}","[0.0, 0.0]","[0.02, nan]"\n')
    (folder / "event.csv").write_text(
        "type,timestamp,event\nEVENT,0,CONTROL_MODE_ENABLE\nEVENT,2e6,DISABLE\n"
    )
    return folder


def write_bam(path: Path) -> Path:
    entries = [
        {
            "position": float(angle),
            "speed": 0.0,
            "input_volts": 7.4,
            "timestamp": float(t),
            "goal_position": float(goal),
            "torque_enable": bool(t < 1.0),
        }
        for t, angle, goal in zip(T, ANGLE[:, 0], GOAL[:, 0], strict=True)
    ]
    facts = {
        "mass": 0.49,
        "length": 0.1,
        "kp": 100,
        "vin": 7.4,
        "motor": "xl330",
        "trajectory": "lift_and_drop",
    }
    path.write_text(json.dumps({**facts, "entries": entries}))
    return path


def channel(column: str, kind: str, **more) -> dict:
    return {"column": column, "unit": "rad", "kind": kind, **more}


def test_tensors_of_pace_are_columns(tmp_path):
    path = write_pace(tmp_path / "chirp_data.pt")
    recording = read_log(
        path,
        {
            "time": {"column": "time", "unit": "s"},
            "channels": {
                "goal": channel("des_dof_pos[1]", "command"),
                "theta": channel("dof_pos[1]", "measurement", scale=-1, offset=0.25),
            },
        },
    )
    np.testing.assert_array_equal(recording.channels["goal"].value, GOAL[:, 1].astype(np.float32))
    np.testing.assert_allclose(
        recording.channels["theta"].value, 0.25 - ANGLE[:, 1].astype(np.float32).astype(float), rtol=1e-12
    )


def test_tensors_are_named_after_the_joints_of_the_file(tmp_path):
    log = open_log(
        write_pace(tmp_path / "a.pt", joint_order=["LF_HAA", "LF_HFE"], image=torch.zeros(3, 4, 5))
    )
    np.testing.assert_array_equal(log.values("", "dof_pos[LF_HFE]"), ANGLE[:, 1].astype(np.float32))
    assert "image" in log.tables[""].left_out


class Stranger:
    """An object that a pickle could contain."""


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"dof_pos": torch.zeros(5, 2)}, "has no tensor time or t of the stamps"),
        (torch.zeros(5), "contains a Tensor; save a dictionary"),
        ({"time": torch.zeros(5), "x": Stranger()}, "contains other objects than tensors"),
        ({"time": torch.zeros(1).expand(1 << 28)}, "has 268435456 values, more than the limit"),
        ({"time": torch.zeros(5, 2)}, '"time" is no vector of stamps'),
    ],
)
def test_other_torch_files_are_refused(tmp_path, content, message):
    torch.save(content, tmp_path / "a.pt")
    with pytest.raises(LogError, match=message):
        open_log(tmp_path / "a.pt")


def test_a_damaged_torch_file_is_refused(tmp_path):
    path = write_pace(tmp_path / "a.pt")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(LogError, match=r"a.pt: (truncated|contains other)"):
        open_log(path)


def test_a_folder_of_sage_is_one_recording_with_named_joints(tmp_path):
    folder = write_sage(tmp_path / "hold_under_gravity")
    assert recordings([tmp_path]) == (folder,)
    time = {"column": "timestamp", "unit": "us"}
    recording = read_log(
        folder,
        {
            "channels": {
                "goal": {"topic": "control", "field": "positions", "joint": "Pitch", "unit": "rad", "kind": "command",
                         "time": time},
                "theta": {"topic": "state_motor", "field": "positions[Pitch]", "unit": "rad", "kind": "measurement",
                          "time": time},
            }
        },
    )  # fmt: skip
    np.testing.assert_array_equal(recording.channels["goal"].value, GOAL[:, 1])
    np.testing.assert_allclose(recording.channels["theta"].t, T + 1e-6, atol=1e-12)
    np.testing.assert_array_equal(recording.channels["theta"].value, ANGLE[:, 1])


def test_a_broken_line_of_a_pair_is_named_with_its_file(tmp_path):
    folder = write_sage(tmp_path / "run")
    lines = (folder / "control.csv").read_text().splitlines()
    lines[6] = lines[6].replace(",", ";", 1)
    (folder / "control.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(LogError, match=r"run/control.csv: line 7 has 2 cells and the header has 3 names"):
        open_log(folder)


def test_entries_of_bam_are_columns_and_facts(tmp_path):
    log = open_log(write_bam(tmp_path / "a.json"))
    assert log.facts == {
        "mass": 0.49, "length": 0.1, "kp": 100, "vin": 7.4, "motor": "xl330", "trajectory": "lift_and_drop"
    }  # fmt: skip
    np.testing.assert_array_equal(log.values("", "goal_position"), GOAL[:, 0])
    np.testing.assert_array_equal(log.values("", "torque_enable"), T < 1.0)
    assert log.tables[""].times == ("timestamp",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"entries": [{"position": 1.0}]}', "the entries have no timestamp or time or t"),
        ('{"entries": 3}', 'has no list "entries" of objects'),
        ('{"entries": [', "truncated or not JSON"),
        ("[" * 100_000, "truncated or not JSON"),
        ('{"entries": []}', "contains no data rows"),
    ],
)
def test_other_json_is_refused(tmp_path, text, message):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(LogError, match=message):
        open_log(tmp_path / "a.json")


SAMPLES = [
    {"time": 0.0, "mode": "HOLD", "joint": {"angle": 0.1}, "u": 1.5},
    {"time": 0.5, "mode": "HOLD", "joint": {"angle": 0.2}},
    {"time": 1.0, "mode": "MOVE", "joint": {"angle": 0.4}, "u": None},
]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.jsonl", "\n".join(map(json.dumps, SAMPLES)) + "\n"),
        ("a.ndjson", "\n\n".join(map(json.dumps, SAMPLES))),
        ("a.json", json.dumps(SAMPLES, indent=1)),
    ],
)
def test_objects_of_json_are_rows_whose_missing_keys_are_empty_cells(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    assert recordings([tmp_path]) == (tmp_path / name,)
    log = open_log(tmp_path / name)
    np.testing.assert_array_equal(log.values("", "joint.angle"), [0.1, 0.2, 0.4])
    np.testing.assert_array_equal(log.tables[""].frame["u"], [1.5, np.nan, np.nan])
    assert list(log.tables[""].frame["mode"]) == ["HOLD", "HOLD", "MOVE"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"t": 0.0}\n\n{"t": 0.1, "q', "line 3 is truncated or not JSON"),
        ('{"t": 0.0}\n[0.1, 0.2]\n', "line 2 is no object"),
        ("\n", "contains no data rows"),
    ],
)
def test_lines_that_are_no_objects_are_named(tmp_path, text, message):
    (tmp_path / "a.jsonl").write_text(text)
    with pytest.raises(LogError, match=message):
        open_log(tmp_path / "a.jsonl")
