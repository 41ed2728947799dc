"""Datasets of LeRobot: written here with pyarrow in the layouts of versions 2.1 and 3.0, and read back."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from deepkoco.logs import LogError, read_log
from deepkoco.logs.formats import open_log
from deepkoco.logs.formats.recordings import recordings

JOINTS = ("shoulder_pan.pos", "shoulder_lift.pos", "gripper.pos")
FPS = 30
LENGTHS = (90, 60, 75)


def signals(episode: int) -> tuple[np.ndarray, np.ndarray]:
    """Action and state (T, 3), float32 as the recorder stores them."""
    t = np.arange(LENGTHS[episode])[:, None] / FPS
    action = np.sin((1.0 + np.arange(3)) * t + episode).astype(np.float32)
    return action, (0.9 * np.roll(action, 2, axis=0)).astype(np.float32)


def frames(episodes) -> pa.Table:
    parts, index = [], 0
    for episode in episodes:
        action, state = signals(episode)
        count = len(action)
        vector = pa.list_(pa.float32(), 3)
        parts.append(
            pa.table(
                {
                    "action": pa.array(list(action), vector),
                    "observation.state": pa.array(list(state), vector),
                    "timestamp": pa.array((np.arange(count) / FPS).astype(np.float32)),
                    "frame_index": pa.array(np.arange(count)),
                    "episode_index": pa.array(np.full(count, episode)),
                    "index": pa.array(np.arange(index, index + count)),
                    "task_index": pa.array(np.zeros(count, dtype=np.int64)),
                }
            )
        )
        index += count
    return pa.concat_tables(parts)


def info(folder: Path, version: str, template: str, **changes) -> dict:
    vector = {"dtype": "float32", "shape": [3], "names": list(JOINTS)}
    scalar = {"dtype": "int64", "shape": [1], "names": None}
    content = {
        "codebase_version": version,
        "robot_type": "so101_follower",
        "total_episodes": len(LENGTHS),
        "total_frames": sum(LENGTHS),
        "chunks_size": 2,
        "fps": FPS,
        "data_path": template,
        "features": {
            "action": vector,
            "observation.state": vector,
            "observation.images.front": {"dtype": "video", "shape": [480, 640, 3], "names": ["h", "w", "c"]},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            **{name: scalar for name in ("frame_index", "episode_index", "index", "task_index")},
        },
        **changes,
    }
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(content))
    return content


def write_v21(folder: Path, **changes) -> Path:
    info(folder, "v2.1", "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet", **changes)
    with (folder / "meta" / "episodes.jsonl").open("w") as file:
        for k, length in enumerate(LENGTHS):
            file.write(json.dumps({"episode_index": k, "tasks": ["move"], "length": length}) + "\n")
            target = folder / f"data/chunk-{k // 2:03d}/episode_{k:06d}.parquet"
            target.parent.mkdir(parents=True, exist_ok=True)
            pq.write_table(frames([k]), target)
    return folder


def write_v30(folder: Path, **changes) -> Path:
    """Episodes 0 and 1 share a file, episode 2 has another."""
    info(folder, "v3.0", "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet", **changes)
    files = {0: [0, 1], 1: [2]}
    rows = {"episode_index": [], "tasks": [], "length": [], "data/chunk_index": [], "data/file_index": []}
    rows |= {"dataset_from_index": [], "dataset_to_index": []}
    begin = 0
    for number, episodes in files.items():
        target = folder / f"data/chunk-000/file-{number:03d}.parquet"
        target.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(frames(episodes), target)
        for episode in episodes:
            end = begin + LENGTHS[episode]
            values = (episode, ["move"], LENGTHS[episode], 0, number, begin, end)
            for column, value in zip(rows.values(), values, strict=True):
                column.append(value)
            begin = end
    target = folder / "meta/episodes/chunk-000/file-000.parquet"
    target.parent.mkdir(parents=True)
    pq.write_table(pa.table(rows), target)
    return folder


WRITERS = {"v2.1": write_v21, "v3.0": write_v30}


def mapping(joint: str = "shoulder_lift.pos") -> dict:
    return {
        "time": {"column": "timestamp", "unit": "s"},
        "channels": {
            "goal": {"column": f"action[{joint}]", "unit": "deg", "kind": "command"},
            "theta": {"column": f"observation.state[{joint}]", "unit": "deg", "kind": "measurement"},
        },
    }


@pytest.mark.parametrize("version", WRITERS)
def test_every_episode_is_read_with_names_and_exact_times(tmp_path, version):
    dataset = WRITERS[version](tmp_path / "mine")
    found = recordings([dataset])
    assert [path.name for path in found] == ["episode_0", "episode_1", "episode_2"]
    for k, path in enumerate(found):
        log = open_log(path)
        assert log.form == f"LeRobot {version}"
        action, state = signals(k)
        for j, joint in enumerate(JOINTS):
            np.testing.assert_array_equal(log.values("", f"action[{joint}]"), action[:, j])
            np.testing.assert_array_equal(log.values("", f"observation.state[{joint}]"), state[:, j])
        np.testing.assert_array_equal(log.values("", "timestamp"), np.arange(LENGTHS[k]) / FPS)


@pytest.mark.parametrize("version", WRITERS)
def test_read_log_takes_the_sidecar_of_the_dataset(tmp_path, version):
    import yaml

    dataset = WRITERS[version](tmp_path / "mine")
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(mapping()))
    recording = read_log(dataset / "episode_2")
    np.testing.assert_allclose(np.degrees(recording.channels["theta"].value), signals(2)[1][:, 1], rtol=1e-12)
    assert recording.path == dataset / "episode_2"


def test_an_unusual_clock_is_kept(tmp_path):
    """Times that are not frame / fps were measured, and stay as they are."""
    dataset = write_v21(tmp_path / "mine")
    file = dataset / "data/chunk-000/episode_000000.parquet"
    table = pq.read_table(file)
    measured = (np.arange(90) / FPS + 0.004 * np.sin(np.arange(90))).astype(np.float32)
    pq.write_table(table.set_column(2, "timestamp", pa.array(measured)), file)
    np.testing.assert_array_equal(open_log(dataset / "episode_0").values("", "timestamp"), measured)


def test_episodes_are_selected_by_number(tmp_path):
    dataset = write_v30(tmp_path / "mine")
    assert [path.name for path in recordings([dataset], [2, 0])] == ["episode_2", "episode_0"]
    with pytest.raises(LogError, match="has no episode 7; it has 3 episodes, 0 to 2"):
        recordings([dataset], [7])
    with pytest.raises(LogError, match="has no episode 7; it has 3 episodes, 0 to 2"):
        open_log(dataset / "episode_7")
    with pytest.raises(LogError, match=r"contains 3 recordings; give one of them, such as .*episode_0"):
        read_log(dataset, mapping())


@pytest.mark.parametrize("version", WRITERS)
@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("observation.state", 'the dataset has no "observation.state", so nothing measured is there'),
        ("action", 'the dataset has no "action", so the commands are not known'),
    ],
)
def test_a_dataset_without_state_or_action_is_refused(tmp_path, version, missing, message):
    features = {
        name: {"dtype": "float32", "shape": [3], "names": list(JOINTS)}
        for name in ("action", "observation.state")
        if name != missing
    }
    dataset = WRITERS[version](tmp_path / "mine", features=features)
    with pytest.raises(LogError, match=message):
        open_log(dataset / "episode_0")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"codebase_version": "v1.6"}, 'version "v1.6" is not known; v2.0, v2.1 and v3.0 are'),
        ({"data_path": "../../{episode_index}.parquet"}, "is no file of the dataset"),
        ({"data_path": "data/{nothing}.parquet"}, "is not understood"),
        ({"features": 3}, 'has no "features"'),
    ],
)
def test_damaged_metadata_is_named(tmp_path, changes, message):
    dataset = write_v21(tmp_path / "mine", **changes)
    with pytest.raises(LogError, match=message):
        open_log(dataset / "episode_0")


def test_a_missing_file_is_named(tmp_path):
    dataset = write_v21(tmp_path / "mine")
    (dataset / "data/chunk-001/episode_000002.parquet").unlink()
    with pytest.raises(LogError, match=r"episode 2: no file data/chunk-001/episode_000002.parquet"):
        open_log(dataset / "episode_2")


def test_names_of_motors_in_a_mapping_are_used(tmp_path):
    names = {"dtype": "float32", "shape": [3], "names": {"motors": list(JOINTS)}}
    dataset = write_v21(tmp_path / "mine", features={"action": names, "observation.state": names})
    assert f"action[{JOINTS[0]}]" in open_log(dataset / "episode_0").tables[""].frame
