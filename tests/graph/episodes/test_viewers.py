"""The files are what viewers of MCAP expect: indexed, in order of log time, JSON that its schema describes."""

import json

import numpy as np
import pytest
from mcap.reader import make_reader

from deepkoco.graph import EpisodeWriter
from deepkoco.graph.episodes.storage.messages import step_schema
from tests.graph.episodes.test_episode_writer import GRAPH

TYPES = {
    "integer": int,
    "number": (int, float),
    "string": str,
    "boolean": bool,
    "array": list,
    "object": dict,
}
NOON = 1_700_000_000 * 10**9


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    with EpisodeWriter(path, GRAPH, origin_ns=NOON) as writer:
        for k in range(30):
            t = k / 100
            writer.step("world", k, t, t + 0.001, np.array([k, np.nan]), {"agent->world": [k - 1]})
            writer.message("world->agent", k, t + 0.001, t + 0.025)
        writer.lost("agent->world", 0, 0.1)
        writer.note(0.2, "too late", "warning", "world")
    return path


def messages(path, topic):
    with path.open("rb") as file:
        return [
            (schema, message, json.loads(message.data))
            for schema, _, message in make_reader(file).iter_messages(topics=[topic])
        ]


def test_the_index_finds_topics_counts_and_attachments(path):
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.chunk_indexes
        counts = {summary.channels[i].topic: n for i, n in summary.statistics.channel_message_counts.items()}
        assert counts == {
            "/node/world": 30,
            "/connection/world/agent": 30,
            "/connection/agent/world": 1,
            "/notes": 1,
        }
        assert {c.message_encoding for c in summary.channels.values()} == {"json"}
        assert {s.encoding for s in summary.schemas.values()} == {"jsonschema"}
        graph = json.loads(next(a for a in reader.iter_attachments() if a.name == "graph.json").data)
        assert [node["name"] for node in graph["nodes"]] == ["world", "agent"]


def test_log_times_are_real_times_in_order(path):
    steps = messages(path, "/node/world")
    assert [m.log_time for _, m, _ in steps] == [NOON + k * 10**7 + 10**6 for k in range(30)]
    first = messages(path, "/connection/world/agent")[0][1]
    assert (first.publish_time, first.log_time) == (NOON + 10**6, NOON + 25 * 10**6)
    assert steps[7][1].sequence == 7


@pytest.mark.parametrize(
    "topic", ["/node/world", "/connection/world/agent", "/connection/agent/world", "/notes"]
)
def test_every_field_is_in_the_schema_with_its_type(path, topic):
    for schema, _, content in messages(path, topic):
        described = json.loads(schema.data)
        assert described["type"] == "object"
        for name, value in content.items():
            kind = described["properties"][name]["type"]
            assert isinstance(value, TYPES[kind]), (name, value)
            assert isinstance(value, bool) == (kind == "boolean")


def test_numbers_can_be_plotted_and_say_when_they_are_none(path):
    _, _, content = messages(path, "/node/world")[3]
    assert content["values"] == [3.0, None]
    assert content["inputs"] == {"agent": [2]}
    assert content["duration"] == pytest.approx(0.001)
    seen = step_schema(GRAPH, "agent")["properties"]["inputs"]["properties"]
    assert list(seen) == ["world"]


def test_notes_are_in_the_schema_of_log_panels(path):
    schema, _, content = messages(path, "/notes")[0]
    assert schema.name == "foxglove.Log"
    assert content["timestamp"] == {"sec": 1_700_000_000, "nsec": 200_000_000}
    assert (content["level"], content["name"], content["message"]) == (3, "world", "too late")
