"""A disk that is full or cannot be written: one sentence, and what was recorded before can be read."""

import numpy as np
import pytest

from deepkoco.graph.episodes.export import export_episodes
from deepkoco.graph.episodes.storage import EpisodeFileError, EpisodeWriter, read_episodes, write_episodes
from deepkoco.output.whole_file import WriteError
from tests.full_disk import largest_file, read_only
from tests.graph.episodes.test_episode_writer import GRAPH

STEPS = 2000
LIMIT = 100_000  # bytes


def _record(writer, steps=STEPS):
    for k in range(steps):
        writer.step("world", k, k / 100, (k + 1) / 100, np.random.default_rng(k).random(4))


def test_a_disk_that_fills_up_during_a_run_leaves_what_was_written(tmp_path):
    path = tmp_path / "run.mcap"
    writer = EpisodeWriter(path, GRAPH)

    def record_and_close():
        _record(writer)
        writer.close()

    with pytest.raises(EpisodeFileError) as told, largest_file(LIMIT):
        record_and_close()
    assert str(told.value).startswith(
        f"{path}: not written any further: {writer.journal}: cannot be written: file too"
    )
    assert "can be read with partial=True" in str(told.value)
    assert list(tmp_path.iterdir()) == [writer.journal]
    steps = read_episodes(writer.journal, partial=True).episodes[0].outputs["world"]
    assert 100 < len(steps) < STEPS
    np.testing.assert_array_equal(steps[7], np.random.default_rng(7).random(4))


def test_a_folder_that_takes_no_file_when_a_run_has_ended_leaves_all_of_it(tmp_path):
    path = tmp_path / "run.mcap"
    writer = EpisodeWriter(path, GRAPH)
    _record(writer, 100)
    with pytest.raises(EpisodeFileError) as told, read_only(tmp_path):
        writer.close()
    assert str(told.value).startswith(f"{path}: cannot be written: permission denied")
    assert f"the whole recording is in {writer.journal}" in str(told.value)
    assert list(tmp_path.iterdir()) == [writer.journal]
    assert read_episodes(writer.journal).complete


def test_a_disk_without_room_for_the_first_record_leaves_nothing(tmp_path):
    with pytest.raises(WriteError, match=r"run\.mcap: cannot be written: file too large"), largest_file(100):
        EpisodeWriter(tmp_path / "run.mcap", GRAPH)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_tables_and_copies_are_written_whole_or_not_at_all(tmp_path, suffix):
    with EpisodeWriter(tmp_path / "run.mcap", GRAPH) as writer:
        _record(writer, 500)
    run = read_episodes(tmp_path / "run.mcap")
    with pytest.raises(WriteError, match=r"copy\.mcap: cannot be written"), largest_file(5000):
        write_episodes(tmp_path / "copy.mcap", run.graph, run.episodes)
    with pytest.raises(WriteError, match=f"table{suffix}: cannot be written"), largest_file(5000):
        export_episodes(tmp_path / f"table{suffix}", run.graph, run.episodes)
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]
