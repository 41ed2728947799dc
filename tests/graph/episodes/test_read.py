"""Damaged recordings: one clear error, and what is whole can be read."""

import numpy as np
import pytest

from deepkoco.graph.episodes.storage import EpisodeFileError, EpisodeWriter, read_episodes
from tests.graph.episodes.test_episode_writer import GRAPH

STEPS = 40


@pytest.fixture(scope="module")
def journal(tmp_path_factory):
    """A stream that has ended but was not indexed: every message stands for itself."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    writer = EpisodeWriter(path, GRAPH)
    for k in range(STEPS):
        writer.step("world", k, k / 100, (k + 1) / 100, np.full(3, k, dtype=np.float32))
    path.touch()
    with pytest.raises(EpisodeFileError):
        writer.close()
    return writer.journal.read_bytes()


def test_a_cut_at_every_place_is_told_and_what_is_whole_is_read(journal, tmp_path):
    path = tmp_path / "cut.mcap"
    path.write_bytes(journal)
    assert read_episodes(path).complete
    begin = journal.index(b'{"episode":0')
    seen = set()
    for size in range(begin, len(journal)):
        # Every place around the first messages and in the summary, then in strides.
        if begin + 700 < size < len(journal) - 60 and size % 37:
            continue
        path.write_bytes(journal[:size])
        run = read_episodes(path, partial=True)
        whole = journal[:size].count(b'"values":[') - (b'"values":[' in journal[:begin]) * 1
        steps = len(run.episodes[0].t_start["world"])
        assert not run.complete
        assert 0 <= whole - steps <= 1
        assert run.messages == steps
        np.testing.assert_array_equal(
            run.episodes[0].outputs.get("world", np.zeros((0, 3))), np.arange(steps)[:, None] * np.ones(3)
        )
        seen.add(steps)
        with pytest.raises(
            EpisodeFileError, match=rf"cut\.mcap: cut off after {steps} whole messages.*partial=True"
        ):
            read_episodes(path)
    assert {0, 1, 2, STEPS} <= seen


def test_a_cut_before_the_graph_is_known_says_so(journal, tmp_path):
    path = tmp_path / "cut.mcap"
    for size in range(8, journal.index(b"graph.json"), 5):
        path.write_bytes(journal[:size])
        with pytest.raises(EpisodeFileError, match=r"holds no description of a graph.*damaged"):
            read_episodes(path, partial=True)


def test_a_finished_file_that_is_cut_later_gives_its_whole_chunks(tmp_path):
    path = tmp_path / "run.mcap"
    with EpisodeWriter(path, GRAPH) as writer:
        for k in range(5000):
            writer.step("world", k, k / 100, (k + 1) / 100, np.full(3, k, dtype=np.float32))
    content = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    counts = []
    for share in (0.5, 0.8, 0.999):
        cut.write_bytes(content[: int(share * len(content))])
        counts.append(read_episodes(cut, partial=True).messages)
    assert 0 < counts[0] < counts[1] <= counts[2] <= 5000
    with pytest.raises(EpisodeFileError, match=f"cut off after {counts[2]} whole messages"):
        read_episodes(cut)


def test_a_wrong_byte_is_told_unless_it_lies_where_no_message_is(tmp_path):
    path, damaged = tmp_path / "run.mcap", tmp_path / "damaged.mcap"
    with EpisodeWriter(path, GRAPH) as writer:
        for k in range(400):
            writer.step("world", k, k / 100, (k + 1) / 100, np.full(3, k, dtype=np.float32))
    content = path.read_bytes()
    whole = read_episodes(path)
    told = 0
    for place in range(8, len(content), 97):
        damaged.write_bytes(content[:place] + bytes([content[place] ^ 0x41]) + content[place + 1 :])
        try:
            run = read_episodes(damaged)
        except EpisodeFileError:
            told += 1
            continue
        for k in ("t_start", "t_end", "outputs"):
            np.testing.assert_array_equal(
                getattr(run.episodes[0], k)["world"], getattr(whole.episodes[0], k)["world"]
            )
    assert told > 20


@pytest.mark.parametrize(("content", "match"), [(b"", "is no MCAP"), (b"time,a\n0,1\n", "is no MCAP")])
def test_what_is_no_recording_is_refused(tmp_path, content, match):
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(EpisodeFileError, match=match):
        read_episodes(path)
    with pytest.raises(EpisodeFileError, match="no such file"):
        read_episodes(tmp_path / "none.mcap")
    with pytest.raises(EpisodeFileError, match="is a folder"):
        read_episodes(tmp_path)


def test_a_step_that_is_missing_or_there_twice_is_named(tmp_path):
    for name, seqs in (("gap", (0, 2)), ("twice", (0, 0))):
        with EpisodeWriter(tmp_path / f"{name}.mcap", GRAPH) as writer:
            for seq in seqs:
                writer.step("world", seq, 0.0, 0.0)
        with pytest.raises(EpisodeFileError, match='node "world": step 1 is missing or there twice'):
            read_episodes(tmp_path / f"{name}.mcap")


def test_a_message_without_a_word_on_its_arrival_counts_as_not_arrived(tmp_path):
    with EpisodeWriter(tmp_path / "run.mcap", GRAPH) as writer:
        for k in range(3):
            writer.step("world", k, k / 10, (k + 1) / 10, np.zeros(1))
        writer.message("world->agent", 1, 0.2, 0.25)
    episode = read_episodes(tmp_path / "run.mcap").episodes[0]
    np.testing.assert_array_equal(episode.t_sent["world->agent"], [0.1, 0.2, 3 / 10])
    np.testing.assert_array_equal(episode.t_received["world->agent"], [np.inf, 0.25, np.inf])
