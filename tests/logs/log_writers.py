"""Write one log in every format that can be read."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from mcap.writer import Writer

Signals = Mapping[str, np.ndarray]
START_NS = 1_700_000_000 * 10**9 + 123_456_789
JOINT = "shoulder"


def mapping(time: str | None = None, **more) -> dict:
    """A sidecar for the topics that the writers below write: theta, omega [rad, rad/s] and torque [N m]."""
    joint = {"topic": "/joint_states", "joint": JOINT, "kind": "measurement"}
    channels = {
        "torque": {
            "topic": "/command",
            "field": "data",
            "unit": "N m",
            "kind": "command",
            "time": "received",
        },
        "theta": {**joint, "field": "position", "unit": "rad"},
        "omega": {**joint, "field": "velocity", "unit": "rad/s"},
    }
    if time is not None:
        channels["theta"]["time"] = channels["omega"]["time"] = time
    return {"system": "rod_pendulum", "channels": channels, **more}


def write_csv(path: Path, signals: Signals) -> Path:
    pd.DataFrame(signals).to_csv(path, index=False)
    return path


def write_json_mcap(path: Path, signals: Signals) -> Path:
    """JointState and a command as JSON, as a bridge to the web would write them."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {t: writer.register_channel(t, "json", schema) for t in ("/joint_states", "/command")}
        for topic, stamp, message in _messages(signals):
            writer.add_message(channels[topic], stamp, json.dumps(message).encode(), stamp)
        writer.finish()
    return path


def write_ros_mcap(path: Path, signals: Signals, encoding: str = "cdr") -> Path:
    """The same as ROS messages in one MCAP file without a bag's metadata."""
    from rosbags.typesys import Stores, get_typestore

    ros1 = encoding == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    names = {"/joint_states": "sensor_msgs/msg/JointState", "/command": "std_msgs/msg/Float64"}
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros1" if ros1 else "ros2")
        channels = {}
        for topic, name in names.items():
            text = store.generate_msgdef(name, ros_version=1 if ros1 else 2)[0]
            shown = name.replace("/msg/", "/") if ros1 else name
            schema = writer.register_schema(shown, "ros1msg" if ros1 else "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, encoding, schema)
        for topic, stamp, message in _messages(signals):
            data = bytes(serialize(_ros(store, names[topic], message, ros1), names[topic]))
            writer.add_message(channels[topic], stamp, data, stamp)
        writer.finish()
    return path


def write_ros1_bag(path: Path, signals: Signals) -> Path:
    from rosbags.rosbag1 import Writer as Bag
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Bag(path) as bag:
        _fill_bag(bag, store, store.serialize_ros1, signals, ros1=True)
    return path


def write_ros2_bag(path: Path, signals: Signals, storage: str = "sqlite3") -> Path:
    """A folder with metadata.yaml and a file of the storage "sqlite3" or "mcap"."""
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Bag
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Bag(path, version=9, storage_plugin=plugin) as bag:
        _fill_bag(bag, store, store.serialize_cdr, signals, ros1=False)
    return path


def _fill_bag(bag, store, serialize: Callable, signals: Signals, ros1: bool) -> None:
    names = {"/joint_states": "sensor_msgs/msg/JointState", "/command": "std_msgs/msg/Float64"}
    connections = {t: bag.add_connection(t, name, typestore=store) for t, name in names.items()}
    for topic, stamp, message in _messages(signals):
        bag.write(
            connections[topic], stamp, serialize(_ros(store, names[topic], message, ros1), names[topic])
        )


def _ros(store, name: str, message: dict, ros1: bool):
    if name == "std_msgs/msg/Float64":
        return store.types[name](message["data"])
    stamp = store.types["builtin_interfaces/msg/Time"](**message["header"]["stamp"])
    header = {"stamp": stamp, "frame_id": ""} | ({"seq": 0} if ros1 else {})
    arrays = {k: np.array(message[k], dtype=np.float64) for k in ("position", "velocity", "effort")}
    return store.types[name](
        header=store.types["std_msgs/msg/Header"](**header), name=message["name"], **arrays
    )


def _messages(signals: Signals):
    """Topic, time received [ns], content; a state is received 2 ms after its stamp. The order of joints alternates."""
    for k, t in enumerate(np.asarray(signals["t"]).tolist()):
        stamp = START_NS + round(t * 1e9)
        joints = {JOINT: (signals["theta"][k], signals["omega"][k]), "elbow": (0.5, 0.0)}
        names = [JOINT, "elbow"] if k % 2 else ["elbow", JOINT]
        state = {
            "header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}},
            "name": names,
            "position": [float(joints[n][0]) for n in names],
            "velocity": [float(joints[n][1]) for n in names],
            "effort": [],
        }
        yield "/command", stamp, {"data": float(signals["torque"][k])}
        yield "/joint_states", stamp + 2_000_000, state


WRITERS: dict[str, Callable[[Path, Signals], Path]] = {
    "json.mcap": write_json_mcap,
    "cdr.mcap": write_ros_mcap,
    "ros1.mcap": lambda path, signals: write_ros_mcap(path, signals, "ros1"),
    "ros1.bag": write_ros1_bag,
    "ros2_sqlite": write_ros2_bag,
    "ros2_mcap": lambda path, signals: write_ros2_bag(path, signals, "mcap"),
}
