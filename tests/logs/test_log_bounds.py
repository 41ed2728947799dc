"""Files that would unpack to far more than their size are refused before they are unpacked."""

import bz2
import sqlite3
import tracemalloc

import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard

from deepkoco.logs import LogError
from deepkoco.logs.formats import open_log
from tests.logs.log_writers import WRITERS, write_ros2_bag

pytest.importorskip("rosbags")
T = 0.02 * np.arange(50)
SIGNALS = {"t": T, "theta": np.sin(T), "omega": np.cos(T), "torque": np.cos(3 * T)}


def test_parquet_with_too_many_values_is_refused_unread(tmp_path):
    """A column of one repeated value takes a few bytes for any number of rows."""
    path = tmp_path / "log.parquet"
    with pq.ParquetWriter(path, pa.schema([("t", pa.int8())]), compression="zstd") as writer:
        table = pa.table({"t": pa.array(np.zeros(1 << 24, dtype=np.int8))})
        for _ in range(9):
            writer.write_table(table, row_group_size=1 << 24)
    assert path.stat().st_size < 1_000_000
    tracemalloc.start()
    with pytest.raises(LogError, match="has 150994944 values, more than the limit"):
        open_log(path)
    assert tracemalloc.get_traced_memory()[1] < 1 << 24
    tracemalloc.stop()


def test_parquet_keeps_a_long_repeated_text_once(tmp_path):
    path = tmp_path / "log.parquet"
    text = pa.DictionaryArray.from_arrays(
        pa.array(np.zeros(20_000, dtype=np.int32)), pa.array(["x" * 1_000_000])
    )
    pq.write_table(pa.table({"t": np.arange(20_000.0), "note": text}), path)
    before = pa.total_allocated_bytes()
    frame = open_log(path).tables[""].frame
    assert pa.total_allocated_bytes() - before < 1 << 27  # the column written out would be 20 GB
    assert frame["note"].iloc[0] is frame["note"].iloc[-1]


def test_parquet_leaves_out_images(tmp_path):
    path = tmp_path / "log.parquet"
    picture = pa.array([{"bytes": b"x" * 100, "path": "a"}] * 3)
    pq.write_table(pa.table({"t": [0.0, 1.0, 2.0], "observation.image": picture}), path)
    table = open_log(path).tables[""]
    assert list(table.frame) == ["t"]
    assert "observation.image" in table.left_out


@pytest.mark.parametrize("pack", [bz2.compress, lz4.frame.compress])
def test_chunks_of_a_ros1_bag_are_bounded(tmp_path, monkeypatch, pack):
    from rosbags.rosbag1 import Writer

    form = Writer.CompressionFormat.BZ2 if pack is bz2.compress else Writer.CompressionFormat.LZ4
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    bag = Writer(tmp_path / "log.bag")
    bag.set_compression(form)
    with bag:
        connection = bag.add_connection("/x", "std_msgs/msg/Float64", typestore=store)
        for k in range(2000):
            message = store.types["std_msgs/msg/Float64"](float(k))
            bag.write(connection, 1000 * k, store.serialize_ros1(message, "std_msgs/msg/Float64"))
    assert open_log(tmp_path / "log.bag").values("/x", "data")[-1] == 1999.0
    monkeypatch.setattr("deepkoco.logs.formats.bag_bounds.LARGEST_CHUNK", 1000)
    with pytest.raises(LogError, match="unpacks to more than 1000 bytes"):
        open_log(tmp_path / "log.bag")


def test_chunks_of_a_ros2_bag_in_mcap_are_bounded(tmp_path, monkeypatch):
    folder = WRITERS["ros2_mcap"](tmp_path / "bag", SIGNALS)
    monkeypatch.setattr("deepkoco.graph.episodes.storage.mcap_records.LARGEST_CHUNK", 100)
    with pytest.raises(LogError, match="a chunk unpacks to"):
        open_log(folder)


def test_a_compressed_file_of_a_bag_is_bounded(tmp_path, monkeypatch):
    folder = write_ros2_bag(tmp_path / "bag", SIGNALS)
    database = next(folder.glob("*.db3"))
    packed = database.with_name(f"{database.name}.zstd")
    packed.write_bytes(zstandard.compress(database.read_bytes()))
    about = folder / "metadata.yaml"
    text = about.read_text().replace(database.name, packed.name)
    text = text.replace("compression_format: ''", "compression_format: zstd").replace(
        "compression_mode: ''", "compression_mode: file"
    )
    about.write_text(text)
    database.unlink()
    assert "mode: file" in text
    assert len(open_log(folder).tables["/command"].frame) == len(T)
    monkeypatch.setattr("deepkoco.logs.formats.bag_bounds.LARGEST_FILE", 4000)
    with pytest.raises(LogError, match="unpacks to more than 4000 bytes"):
        open_log(folder)


def test_a_database_with_computed_messages_is_refused(tmp_path):
    """A view could give messages without end."""
    folder = write_ros2_bag(tmp_path / "bag", SIGNALS)
    database = next(folder.glob("*.db3"))
    connection = sqlite3.connect(database)
    connection.execute("ALTER TABLE messages RENAME TO kept")
    connection.execute(
        "CREATE VIEW messages AS SELECT id, topic_id, timestamp, zeroblob(1e9) AS data FROM kept"
    )
    connection.commit()
    connection.close()
    with pytest.raises(LogError, match='the view "messages" computes values'):
        open_log(folder)
