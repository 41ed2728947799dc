"""Streaming: any thread may write, a crash keeps what was written, nothing is overwritten."""

import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import torch

from deepkoco.graph import Connection, Graph, Supervisor
from deepkoco.graph.episodes.episode import Episode, Note
from deepkoco.graph.episodes.storage import EpisodeFileError, EpisodeWriter, RecordedNode, read_episodes

GRAPH = Graph(
    [RecordedNode("world", 100, kind="World"), Supervisor(rate=50, initial_action=torch.zeros(1))],
    [Connection("world", "agent", 0.005, window=2), Connection("agent", "world", skip=True)],
)


def test_streamed_steps_messages_and_notes_come_back(tmp_path):
    with EpisodeWriter(tmp_path / "run.mcap", GRAPH, {"robot": "rod"}, origin_ns=10**18) as writer:
        writer.step("world", 0, 0.1, 0.1 + 1e-17, torch.tensor([0.1, -0.0]), {"agent->world": [-1]})
        writer.message("world->agent", 0, 0.1, 1 / 3)
        writer.step("world", 1, 0.2, 0.3, np.array([np.nan, 1], dtype=np.float32), {"agent->world": [-1]})
        writer.lost("world->agent", 1, 0.3)
        writer.note(0.25, "took 100 ms of 10 ms", "warning", "world")
        writer.step("agent", 0, 0.4, 0.4, windows={"world->agent": [-1, 0]})
        writer.begin(meta={"seed": 1})
        writer.step("agent", 0, 0.0, 0.0, windows={"world->agent": [-2, -1]})
    run = read_episodes(tmp_path / "run.mcap")
    assert run.meta == {"robot": "rod"}
    assert run.episode_meta == ({}, {"seed": 1})
    assert run.origins == (10**18, 10**18 + 2 * 10**9)
    first, second = run.episodes
    np.testing.assert_array_equal(first.t_start["world"], [0.1, 0.2])
    assert first.outputs["world"].dtype == np.float32
    assert first.outputs["world"].tobytes() == np.array([[0.1, -0.0], [np.nan, 1]], dtype="f4").tobytes()
    np.testing.assert_array_equal(first.t_received["world->agent"], [1 / 3, np.inf])
    np.testing.assert_array_equal(first.windows["world->agent"], [[-1, 0]])
    assert first.notes == (Note(0.25, "warning", "world", "took 100 ms of 10 ms"),)
    assert "agent" not in first.outputs
    np.testing.assert_array_equal(second.windows["world->agent"], [[-2, -1]])


def test_what_was_written_beyond_the_end_of_an_episode_is_left_out(tmp_path):
    with EpisodeWriter(tmp_path / "run.mcap", GRAPH) as writer:
        for k in range(3):
            writer.step("world", k, k / 100, k / 100 + 0.001, np.array([k]), {"agent->world": [-1]})
            writer.message("world->agent", k, k / 100 + 0.001, k / 100 + 0.006)
            writer.step("agent", k, k / 50, k / 50 + 0.002, np.array([k]), {"world->agent": [-2, -1]})
        # The agent's step 1 is the last one: it only starts. Step 2 of the world came after it.
        start = {"world": np.array([0.0, 0.01]), "agent": np.array([0.0, 0.02])}
        sent = {"world->agent": np.array([0.001, 0.011]), "agent->world": np.array([0.002])}
        writer.end(Episode(start, start, {}, sent, sent, {}))
        writer.begin()
        writer.step("world", 0, 0.0, 0.0, np.array([7]))
    first, second = read_episodes(tmp_path / "run.mcap").episodes
    np.testing.assert_array_equal(first.t_start["world"], [0.0, 0.01])
    np.testing.assert_array_equal(first.t_end["agent"], [0.002, 0.02])
    assert {name: len(output) for name, output in first.outputs.items()} == {"world": 2, "agent": 1}
    np.testing.assert_array_equal(first.t_received["world->agent"], [0.006, 0.016])
    np.testing.assert_array_equal(first.windows["world->agent"], [[-2, -1], [-2, -1]])
    np.testing.assert_array_equal(second.outputs["world"], [[7]])


def test_many_threads_write_one_file(tmp_path):
    def work(writer, name, count):
        for k in range(count):
            writer.step(name, k, k / 10, k / 10, np.array([k]))

    with EpisodeWriter(tmp_path / "run.mcap", GRAPH) as writer:
        threads = [threading.Thread(target=work, args=(writer, name, 500)) for name in ("world", "agent")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    episode = read_episodes(tmp_path / "run.mcap").episodes[0]
    for name in ("world", "agent"):
        np.testing.assert_array_equal(episode.outputs[name][:, 0], np.arange(500))


CRASH = """
import os, signal, sys, time
import numpy as np
sys.path.insert(0, sys.argv[2])
from tests.graph.episodes.test_episode_writer import GRAPH
from deepkoco.graph.episodes.storage import EpisodeWriter
writer = EpisodeWriter(sys.argv[1], GRAPH)
for k in range(300):
    writer.step("world", k, k / 100, k / 100, np.full(3, k, dtype=np.float32))
time.sleep(0.3)  # the writer needs milliseconds; a machine under load more
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_program_leaves_what_it_wrote(tmp_path):
    root = Path(__file__).parents[3]
    path = tmp_path / "run.mcap"
    done = subprocess.run([sys.executable, "-c", CRASH, str(path), str(root)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert not path.exists()
    journal = tmp_path / "run.mcap.partial"
    with pytest.raises(
        EpisodeFileError, match=r"cut off after 300 whole messages: 300 steps of 2 nodes, 2\.990 s"
    ):
        read_episodes(journal)
    run = read_episodes(journal, partial=True)
    assert not run.complete
    np.testing.assert_array_equal(run.episodes[0].outputs["world"][:, 2], np.arange(300))
    with pytest.raises(EpisodeFileError, match="left by a run that did not finish"):
        EpisodeWriter(path, GRAPH)


def test_a_run_that_fails_keeps_its_recording(tmp_path):
    def run():
        with EpisodeWriter(tmp_path / "run.mcap", GRAPH) as writer:
            writer.step("world", 0, 0.0, 0.1, np.zeros(1))
            raise ZeroDivisionError("no gain")

    with pytest.raises(ZeroDivisionError):
        run()
    recorded = read_episodes(tmp_path / "run.mcap")
    assert (recorded.complete, recorded.failures) == (False, {0: "ZeroDivisionError: no gain"})
    assert recorded.episodes[0].t_end["world"].tolist() == [0.1]
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def test_an_episode_that_has_ended_is_complete_although_the_program_fails_afterwards(tmp_path):
    times = {"world": np.array([0.0, 0.01]), "agent": np.array([0.0, 0.02])}
    sent = {"world->agent": np.array([0.001, 0.011]), "agent->world": np.array([0.002])}
    episode = Episode(times, times, {}, sent, sent, {})

    def run():
        with EpisodeWriter(tmp_path / "run.mcap", GRAPH) as writer:
            writer.begin()
            for node, starts in times.items():
                for seq, start in enumerate(starts):
                    writer.step(node, seq, start, start)
            writer.end(episode)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run()
    assert read_episodes(tmp_path / "run.mcap").complete


def test_nothing_is_overwritten(tmp_path):
    path = tmp_path / "run.mcap"
    writer = EpisodeWriter(path, GRAPH)
    path.write_text("of another run")
    with pytest.raises(EpisodeFileError, match="exists"):
        writer.close()
    assert path.read_text() == "of another run"
    assert read_episodes(writer.journal).complete
    with pytest.raises(EpisodeFileError, match="exists"):
        EpisodeWriter(path, GRAPH)


@pytest.mark.parametrize(
    ("write", "match"),
    [
        (lambda w: w.step("motor", 0, 0, 0), '"motor" is no node; known: world, agent'),
        (lambda w: w.step("world", 0, 0, float("nan")), 'step 0 of node "world": times 0 s and nan s'),
        (lambda w: w.step("world", 0, 0, 0, np.array(["a"])), "not numeric"),
        (lambda w: w.step("agent", 0, 0, 0, windows={"world->agent": [1]}), r"window \[1\] does not fit"),
        (lambda w: w.message("agent->motor", 0, 0, 0), '"agent->motor" is no connection'),
        (lambda w: w.note(0, "hm", "loud"), "known: debug, info, warning, error, fatal"),
    ],
)
def test_what_does_not_fit_the_graph_is_refused_at_once(tmp_path, write, match):
    with EpisodeWriter(tmp_path / "run.mcap", GRAPH) as writer, pytest.raises(EpisodeFileError, match=match):
        write(writer)


def test_a_closed_writer_says_so(tmp_path):
    writer = EpisodeWriter(tmp_path / "run.mcap", GRAPH)
    writer.close()
    writer.close()
    with pytest.raises(EpisodeFileError, match="closed"):
        writer.step("world", 0, 0, 0)


def test_a_bad_place_is_refused_before_the_run(tmp_path):
    with pytest.raises(EpisodeFileError, match=r"ends in \.mcap"):
        EpisodeWriter(tmp_path / "run.npz", GRAPH)
    with pytest.raises(EpisodeFileError, match="no folder"):
        EpisodeWriter(tmp_path / "there" / "run.mcap", GRAPH)
    with pytest.raises(EpisodeFileError, match="no JSON"):
        EpisodeWriter(tmp_path / "run.mcap", GRAPH, {"t": {1, 2}})
    assert not list(tmp_path.iterdir())
