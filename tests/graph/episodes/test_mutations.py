"""Whatever stands in a recording is read as it was recorded or refused with one error, never with another."""

import contextlib
import json
import random
import resource
from functools import cache
from io import BytesIO

import numpy as np
import pytest
import torch
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Chunk, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from deepkoco.graph import Connection, Graph, Supervisor
from deepkoco.graph.delay import Mixture, Uniform
from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.storage import EpisodeFileError, EpisodeWriter, RecordedNode, read_episodes
from deepkoco.graph.episodes.storage.summary import summarise_run
from deepkoco.logs.formats import open_log
from deepkoco.logs.formats.log_file import LogError

GRAPH = Graph(
    [
        RecordedNode("world", 100, kind="World", delay=Uniform(0.001, 0.002)),
        RecordedNode("camera", 20, kind="Camera", phase=0.01),
        Supervisor(rate=50, initial_action=torch.zeros(1)),
    ],
    [
        Connection("world", "agent", Mixture((Uniform(0.0, 0.004), Uniform(0.1, 0.2)), (0.9, 0.1)), window=2),
        Connection("camera", "agent", 0.02),
        Connection("agent", "world", skip=True),
    ],
)
WRONG = (
    None, True, -1, 0, 1.5, 2**31, 10**30, 1e308, "", "a", "1e999999999", "NaN", [], [[]], [None], {}, {"a": []},
    ["a", 1], [-1], [2**40], "<f8", "V8", "O", "<U1000000", "i4,f8",
)  # fmt: skip
NOT_PYTHON = (
    "NaN",
    "Infinity",
    "1e999",
    "9" * 6000,
    "[" * 3000 + "]" * 3000,
    '{"a":' * 500 + "1" + "}" * 500,
    "{",
    "",
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A finished recording with every kind of message."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    with EpisodeWriter(path, GRAPH, {"robot": "rod"}, origin_ns=10**18) as writer:
        for _ in range(2):
            writer.begin(meta={"seed": 1})
            for k in range(6):
                times = k / 100, (k + 1) / 100
                writer.step(
                    "world", k, *times, np.full(3, k / 3, dtype=np.float32), {"agent->world": [k - 1]}
                )
                writer.message("world->agent", k, times[1], times[1] + 0.002)
            image = np.arange(2000, dtype=np.uint8).reshape(40, 50)
            writer.step("camera", 0, 0.01, 0.02, image)
            writer.lost("camera->agent", 0, 0.02)
            for k in range(3):
                action = np.array([k == 1, True])
                writer.step(
                    "agent", k, k / 50, k / 50, action, {"world->agent": [-2, -1], "camera->agent": [-1]}
                )
                writer.message("agent->world", k, k / 50, k / 50)
            writer.note(0.01, "late", "warning", "world")
            writer.end(_extent())
    return path.read_bytes()


def _extent():
    counts = {"world": 6, "camera": 1, "agent": 3}
    times = {name: np.arange(n) / 50 for name, n in counts.items()}
    sent = {c.key: times[c.sender] for c in GRAPH.connections}
    return Episode(times, times, {}, sent, sent, {})


@cache
def records(content):
    found = []
    for record in StreamReader(BytesIO(content)).records:
        if isinstance(record, DataEnd):
            break
        found.append(record)
    return tuple(found)


def rewritten(every):
    """An MCAP file of these records, with right checksums."""
    file = BytesIO()
    _write(Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True), every)
    return file.getvalue()


def _write(writer, every):
    writer.start(library="deepkoco")
    schemas, channels = {0: 0}, {}
    for r in every:
        match r:
            case Schema():
                schemas[r.id] = writer.register_schema(r.name, r.encoding, r.data)
            case Channel():
                schema = schemas.get(r.schema_id, 0)
                channels[r.id] = writer.register_channel(r.topic, r.message_encoding, schema, r.metadata)
            case Message():
                writer.add_message(
                    channels.get(r.channel_id, 999), r.log_time, r.data, r.publish_time, r.sequence
                )
            case Metadata():
                writer.add_metadata(r.name, r.metadata)
            case Attachment():
                writer.add_attachment(r.create_time, r.log_time, r.name, r.media_type, r.data)
    writer.finish()


def places(content, at=()):
    """Every place in a JSON value: keys and positions from its top."""
    yield at
    inner = (
        content.items()
        if isinstance(content, dict)
        else enumerate(content[:3])
        if isinstance(content, list)
        else ()
    )
    for key, value in inner:
        yield from places(value, (*at, key))


def changed(content, at, value, how):
    """A copy of a JSON value with one place set, deleted, or given an entry more."""
    content = json.loads(json.dumps(content))
    if not at:
        return value
    parent = content
    for key in at[:-1]:
        parent = parent[key]
    if how == "set":
        parent[at[-1]] = value
    elif how == "delete":
        del parent[at[-1]]
    elif isinstance(parent, dict):
        parent["more"] = value
    else:
        parent.append(value)
    return content


def with_json(record, text):
    """A copy of a record with another content."""
    match record:
        case Message():
            return Message(
                channel_id=record.channel_id, log_time=record.log_time, data=text.encode(),
                publish_time=record.publish_time, sequence=record.sequence,
            )  # fmt: skip
        case Attachment():
            return Attachment(
                create_time=0, log_time=0, name=record.name, media_type=record.media_type, data=text.encode()
            )
    raise TypeError(record)


def mutants(every):
    """(name, records) of every place of every kind of content, set to every wrong value, deleted, added to."""
    seen = set()
    for number, record in enumerate(every):
        if isinstance(record, Message | Attachment):
            key = getattr(record, "channel_id", None)
            if key in seen:
                continue
            seen.add(key)
            content = json.loads(record.data)
            texts = []
            for at in places(content):
                texts += [(at, "set", value, changed(content, at, value, "set")) for value in WRONG]
                texts += [(at, how, 0, changed(content, at, 0, how)) for how in ("delete", "add") if at]
            for at, how, value, new in texts:
                yield (
                    f"{number} {at} {how} {value!r}",
                    _replaced(every, number, with_json(record, json.dumps(new))),
                )
            for text in NOT_PYTHON:
                yield f"{number} {text[:20]}", _replaced(every, number, with_json(record, text))
                first = json.dumps(next(iter(content)))
                raw = record.data.decode().replace(f"{first}:", f'{first}:{text},"was":', 1)
                yield f"{number} {first} {text[:20]}", _replaced(every, number, with_json(record, raw))
            yield f"{number} no text", _replaced(every, number, with_json(record, "\x00"))
        elif isinstance(record, Metadata) and record.name not in seen:
            seen.add(record.name)
            for name in record.metadata:
                for text in (*NOT_PYTHON, *map(json.dumps, WRONG), "-1", " 1", "1_0", "٣"):
                    new = Metadata(record.name, record.metadata | {name: text})
                    yield f"{record.name}.{name} {text[:20]}", _replaced(every, number, new)
                less = {k: v for k, v in record.metadata.items() if k != name}
                yield f"{record.name} without {name}", _replaced(every, number, Metadata(record.name, less))
        if isinstance(record, Metadata | Attachment | Channel | Message):
            yield f"without {number}", (*every[:number], *every[number + 1 :])
            if not isinstance(record, Channel):
                yield f"{number} twice", (*every[: number + 1], record, *every[number + 1 :])
        if isinstance(record, Channel):
            for metadata in ({}, {"node": "motor"}, {"connection": "a->b"}, {"node": "world", "notes": ""}):
                new = Channel(
                    id=record.id, topic=record.topic, message_encoding=record.message_encoding,
                    schema_id=record.schema_id, metadata=metadata,
                )  # fmt: skip
                yield f"{record.topic} {metadata}", _replaced(every, number, new)


def _replaced(every, number, new):
    return (*every[:number], new, *every[number + 1 :])


def read_both_ways(path):
    """Read whole, as far as it goes and as a log; give the run if it was read."""
    run = None
    with contextlib.suppress(EpisodeFileError):
        run = read_episodes(path)
    with contextlib.suppress(EpisodeFileError):
        summarise_run(read_episodes(path, partial=True))
    return run


def values(run):
    """All that a recording says of its episodes."""
    return [
        {
            name: {key: np.asarray(value).tolist() for key, value in getattr(episode, name).items()}
            for name in ("t_start", "t_end", "outputs", "t_sent", "t_received", "windows")
        }
        | {"notes": episode.notes}
        for episode in run.episodes
    ]


def test_a_recording_that_is_rewritten_unchanged_is_read_as_before(tmp_path, recording):
    content = recording
    (tmp_path / "a.mcap").write_bytes(content)
    (tmp_path / "b.mcap").write_bytes(rewritten(records(content)))
    before, after = (read_episodes(tmp_path / name) for name in ("a.mcap", "b.mcap"))
    assert values(before) == values(after)
    assert len(before.episodes) == 2


def test_every_changed_entry_is_refused_with_an_error_of_episode_files_or_read(tmp_path, recording):
    """A sample of the 5,000 mutants, drawn by a seed; each kind of content is among them."""
    every = list(mutants(records(recording)))
    path = tmp_path / "changed.mcap"
    refused = 0
    sample = random.Random(20).sample(every, 350)
    for name, mutant in sample:
        path.write_bytes(rewritten(mutant))
        try:
            run = read_both_ways(path)
        except Exception as error:
            raise AssertionError(f"{name}: {type(error).__name__}: {error}") from error
        refused += run is None
    assert refused > 0.7 * len(sample)


ENTRIES = {
    "negative seq": ("/connection/world/agent", {"seq": -1}, "seq -1 is no whole number"),
    "seq that would take gigabytes": (
        "/connection/world/agent",
        {"seq": 2**40},
        "seq 1099511627776 is no whole",
    ),
    "seq there twice": ("/connection/world/agent", {"seq": 1}, "message 1 is there twice"),
    "seq of another type": ("/node/world", {"seq": "0"}, "seq '0' is no whole number"),
    "truth as a seq": ("/node/world", {"seq": False}, "seq False is no whole number"),
    "episode that has not begun": ("/node/world", {"episode": 7}, "episode 7, which has not begun"),
    "time that is no number": ("/node/world", {"t_end": [1]}, r"t_end \[1\] is no finite number"),
    "time that is not the duration's": ("/node/world", {"t_end": 5.0}, "duration 0.01 is not the difference"),
    "window too long": ("/node/world", {"inputs": {"agent": [0, 1]}}, "no list of the 1 steps that are seen"),
    "window of no input": ("/node/world", {"inputs": {"motor": [0]}}, '"motor" is no input; known: agent'),
    "shape that would take gigabytes": (
        "/node/camera",
        {"shape": [2**30, 2]},
        "raw does not hold the 2147483648",
    ),
    "objects as an output": ("/node/camera", {"dtype": "|O8"}, "is no type of numbers"),
    "bytes of another length": ("/node/camera", {"raw": "AAAA"}, "raw does not hold the 2000 numbers"),
    "letters among numbers": ("/node/world", {"values": [1, "2", 3]}, "are no numbers of dtype <f4"),
    "number beyond the dtype": ("/node/world", {"values": [1, 1e300, 3]}, "are no numbers of dtype <f4"),
    "fewer values than the shape": ("/node/world", {"values": [1]}, r"are not the 3 numbers of shape \[3\]"),
    "lost and received": ("/connection/world/agent", {"lost": True}, "lost is true, and t_received is there"),
    "unknown level": ("/notes", {"level": 9}, "level 9 is no whole number from 1 to 5"),
}


@pytest.mark.parametrize("case", ENTRIES)
def test_a_wrong_entry_is_named_and_what_comes_before_it_can_be_read(tmp_path, recording, case):
    topic, entries, match = ENTRIES[case]
    every = records(recording)
    channel = next(r.id for r in every if isinstance(r, Channel) and r.topic == topic)
    number = next(n for n, r in enumerate(every) if isinstance(r, Message) and r.channel_id == channel)
    text = json.dumps(json.loads(every[number].data) | entries)
    path = tmp_path / "changed.mcap"
    path.write_bytes(rewritten(_replaced(every, number, with_json(every[number], text))))
    with pytest.raises(EpisodeFileError, match=rf"changed\.mcap: .*{match}"):
        read_episodes(path)
    with pytest.raises(LogError, match=rf"changed\.mcap: .*{match}"):
        open_log(path)
    if "twice" not in match:
        assert not read_episodes(path, partial=True).complete


@pytest.mark.parametrize("compressed", [False, True])
def test_every_cut_and_every_flipped_bit_is_read_or_refused(tmp_path, recording, compressed):
    content = recording
    if not compressed:
        content = _single_messages(records(content))
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    whole = values(read_episodes(path))
    generator = random.Random(7)
    for _ in range(150):
        place, bit = generator.randrange(8, len(content)), 1 << generator.randrange(8)
        path.write_bytes(content[:place] + bytes([content[place] ^ bit]) + content[place + 1 :])
        run = read_both_ways(path)
        if compressed and run is not None:
            assert values(run) == whole
    for size in generator.sample(range(len(content)), 100):
        path.write_bytes(content[:size])
        assert read_both_ways(path) is None


def _single_messages(every):
    """The journal that a run writes: no chunks."""
    file = BytesIO()
    writer = Writer(file, compression=CompressionType.NONE, use_chunking=False)
    _write(writer, every)
    return file.getvalue()


def _packed_zeros(size):
    packed = BytesIO()
    with zstandard.ZstdCompressor(level=1).stream_writer(packed, size=size, closefd=False) as writer:
        for _ in range(size >> 20):
            writer.write(bytes(1 << 20))
    return packed.getvalue()


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path, recording):
    """A chunk of 1 GiB of zeros takes 32 kB."""
    content = recording
    zeros = _packed_zeros(1 << 30)
    for announced in (1 << 30, 100):
        bomb = RecordBuilder()
        Chunk(
            compression="zstd", data=zeros, message_start_time=0, message_end_time=0, uncompressed_crc=0,
            uncompressed_size=announced,
        ).write(bomb)  # fmt: skip
        bomb = bomb.end()
        path = tmp_path / "bomb.mcap"
        path.write_bytes(content[:8] + bomb + content[8:])
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for read, error in ((read_episodes, EpisodeFileError), (open_log, LogError)):
            with pytest.raises(error, match=r"bomb\.mcap"):
                read(path)
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KiB
