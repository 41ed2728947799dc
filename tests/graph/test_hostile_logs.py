"""Files of logs that ask for too much memory, time or recursion are refused in one sentence."""

import contextlib
import json
import resource
import time
from pathlib import Path

import pytest
from mcap.writer import Writer

from deepkoco.logs.formats import open_log
from deepkoco.logs.formats.log_file import LogError
from deepkoco.logs.formats.ros_definition import check_size

SEPARATOR = "=" * 80
DEFINITIONS = {
    "long array of texts": "string[300000000] a",
    "long array of messages": f"B[300000000] a\n{SEPARATOR}\nMSG: pkg/B\nfloat64 x",
    "arrays in arrays": "\n".join(
        ["B[2000] a"]
        + [f"{SEPARATOR}\nMSG: pkg/{a}\n{b}[2000] a" for a, b in ("BC", "CD", "DE")]
        + [f"{SEPARATOR}\nMSG: pkg/E\nstring x"]
    ),
    "more fields than fit": "\n".join(f"float64 a{i}" for i in range(5000)),
    "message in itself": "A[2] a",
    "more text than fits": "# " + "x" * 300_000,
    "no definition": "[[[" * 1000,
    "no text": b"\xff\xfe",
}


def _mcap(path: Path, encoding: str, schema: tuple[str, str, bytes], *messages: bytes) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/joint", encoding, writer.register_schema(*schema))
        for k, data in enumerate(messages):
            writer.add_message(channel, k * 10**7, data, k * 10**7)
        writer.finish()
    return path


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize("what", DEFINITIONS)
def test_a_definition_without_bound_is_refused_before_a_message_is_read(tmp_path, what, encoding):
    text = DEFINITIONS[what]
    schema = ("pkg/A", f"{encoding}msg", text if isinstance(text, bytes) else text.encode())
    path = _mcap(tmp_path / "log.mcap", encoding, schema, b"\0\1\0\0" + b"\xff" * 200)
    memory, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with pytest.raises(LogError, match=r"log\.mcap: no topic can be read.*(definition|type)"):
        open_log(path)
    assert time.process_time() - start < 10.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < 300_000  # KiB


def test_usual_definitions_are_small_enough():
    from rosbags.typesys import Stores, get_typestore

    for store in (Stores.ROS1_NOETIC, Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY):
        known = get_typestore(store).fielddefs
        for name in known:
            check_size(name, known)
    assert len(known) > 100


NESTED = {
    "nested too deep to be parsed": b'{"a":' * 30_000 + b"1" + b"}" * 30_000,
    "stamp beyond all numbers": b'{"stamp": {"sec": 1' + b"0" * 400 + b', "nanosec": 0}}',
    "long integer": b'{"a": ' + b"9" * 6000 + b"}",
}


@pytest.mark.parametrize("what", NESTED)
def test_json_without_bound_is_refused(tmp_path, what):
    path = _mcap(tmp_path / "log.mcap", "json", ("any", "jsonschema", b"{}"), NESTED[what])
    with pytest.raises(LogError, match=r'log\.mcap: topic "/joint": message 1 is not json'):
        open_log(path)


def test_json_of_every_depth_is_read_or_refused(tmp_path):
    for depth in (10, 300, 600, 850, 900, 950, 980, 1000):
        data = b'{"a":' * depth + b"1" + b"}" * depth
        path = _mcap(tmp_path / "log.mcap", "json", ("any", "jsonschema", b"{}"), data)
        with contextlib.suppress(LogError):
            assert len(open_log(path).tables["/joint"].frame) == 1
    assert depth == 1000


def test_messages_that_all_have_other_fields_are_refused(tmp_path):
    """A table of them would have a column for each."""
    messages = [json.dumps({f"a{k}": k}).encode() for k in range(12_000)]
    path = _mcap(tmp_path / "log.mcap", "json", ("any", "jsonschema", b"{}"), *messages)
    with pytest.raises(LogError, match=r"12000 messages have 12000 different fields"):
        open_log(path)
