"""JointState and messages of commands, in MCAP and in ROS 2 bags, written with the libraries mcap and rosbags."""

from pathlib import Path

import numpy as np
import pytest

from deepkoco.logs import read_log
from deepkoco.logs.formats import open_log

pytest.importorskip("rosbags")
T = 0.01 * np.arange(300)
JOINTS = ("shoulder", "elbow")
GOAL = np.stack([np.sin(2 * T), np.cos(3 * T)], axis=1)
ANGLE = 0.95 * np.roll(GOAL, 3, axis=0)
START = 1_700_000_000 * 10**9


def write(path: Path, storage: str) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = store.types
    stamp = kind["builtin_interfaces/msg/Time"]
    header = kind["std_msgs/msg/Header"]
    empty = np.zeros(0)
    names = {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/trajectory": "trajectory_msgs/msg/JointTrajectory",
        "/goals": "std_msgs/msg/Float64MultiArray",
    }
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        topics = {topic: bag.add_connection(topic, name, typestore=store) for topic, name in names.items()}
        for t, goal, angle in zip(T, GOAL, ANGLE, strict=True):
            now = START + round(t * 1e9)
            head = header(stamp=stamp(sec=now // 10**9, nanosec=now % 10**9), frame_id="")
            none = header(stamp=stamp(sec=0, nanosec=0), frame_id="")  # "as soon as possible"
            points = [
                kind["trajectory_msgs/msg/JointTrajectoryPoint"](
                    positions=goal + 10.0 * k,
                    velocities=empty,
                    accelerations=empty,
                    effort=empty,
                    time_from_start=kind["builtin_interfaces/msg/Duration"](sec=k, nanosec=0),
                )
                for k in range(2)  # as many points as joints
            ]
            layout = kind["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
            messages = {
                "/joint_states": kind[names["/joint_states"]](
                    header=head, name=list(JOINTS), position=angle, velocity=0.0 * angle, effort=empty
                ),
                "/trajectory": kind[names["/trajectory"]](
                    header=none, joint_names=list(JOINTS), points=points
                ),
                "/goals": kind[names["/goals"]](layout=layout, data=goal),
            }
            for topic, message in messages.items():
                bag.write(topics[topic], now, store.serialize_cdr(message, names[topic]))
    return path


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
@pytest.mark.parametrize("single", [False, True])
def test_commands_and_states_of_joints_are_read(tmp_path, storage, single):
    folder = write(tmp_path / "bag", storage)
    path = next(folder.glob("*.mcap" if storage == "mcap" else "*.db3")) if single else folder
    state = {"topic": "/joint_states", "field": "position", "unit": "rad", "kind": "measurement"}
    command = {"topic": "/trajectory", "unit": "rad", "kind": "command"}
    recording = read_log(
        path,
        {
            "channels": {
                "q_elbow": {**state, "joint": "elbow"},
                "q_shoulder": {**state, "joint": "shoulder"},
                "elbow": {**command, "field": "points[0].positions[elbow]"},
                "shoulder": {"topic": "/goals", "field": "data[0]", "unit": "rad", "kind": "command"},
            }
        },
    )
    for j, joint in enumerate(JOINTS):
        np.testing.assert_array_equal(recording.channels[joint].value, GOAL[:, j])
        np.testing.assert_array_equal(recording.channels[f"q_{joint}"].value, ANGLE[:, j])
        np.testing.assert_allclose(recording.channels[joint].t, T, atol=1e-9)


def test_points_of_a_trajectory_are_numbered_and_not_named_after_joints(tmp_path):
    table = open_log(write(tmp_path / "bag", "sqlite3")).tables["/trajectory"]
    assert {"points[0].positions[shoulder]", "points[1].positions[elbow]"} <= set(table.frame)
    np.testing.assert_array_equal(table.frame["points[1].positions[elbow]"], GOAL[:, 1] + 10.0)
    assert table.times[0] == "received"  # the stamp of the header is always 0
