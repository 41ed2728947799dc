"""A recording that is written while a run goes on is the episode that `finish` returns, and outlives a crash."""

import re
import signal
import time

import numpy as np
import pytest
import torch
from live_nodes import AMPLE, act, assert_same, devices, loop
from test_safe_stop import start

from deepkoco.graph import (
    Episode,
    EpisodeFileError,
    EpisodeWriter,
    Gaussian,
    Graph,
    NodeFailure,
    common_part,
    draw_timing,
    read_episodes,
    replay_episode,
    replay_timing,
    write_episodes,
)
from deepkoco.graph.live import ConcurrentRuntime, WallClockRuntime
from tests.on_time import on_time

LOSSY = {
    "sensor->agent": {"law": "lossy", "delay": 0.002, "probability": 0.4},
    "world->sensor": Gaussian(0.004, 0.004),
}


def by_timing(graph: Graph, record) -> ConcurrentRuntime:
    timing = draw_timing(graph, np.random.default_rng(0), 20, 1, LOSSY)
    return ConcurrentRuntime(
        graph, timing, processes={"world": 1, "sensor": 1}, beat_limit=AMPLE, record=record
    )


RUNTIMES = {
    "by a timing": by_timing,
    "by the protocol": lambda graph, record: ConcurrentRuntime(graph, record=record),
    "by the clock": lambda graph, record: ConcurrentRuntime(
        graph, sync=False, real_time_factor=5.0, record=record
    ),
    "wall clock": lambda graph, record: WallClockRuntime(
        graph, threads=("actuator",), beat_limit=AMPLE, record=record
    ),
}


def assert_replays(graph: Graph, episode: Episode) -> None:
    again, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(0))
    for name, output in episode.outputs.items():
        np.testing.assert_array_equal(output, again.outputs[name])


@pytest.mark.parametrize("kind", RUNTIMES)
def test_the_recording_is_the_episode_of_finish_and_replays_bitwise(tmp_path, kind):
    graph = loop()
    with RUNTIMES[kind](graph, tmp_path / "run.mcap") as runtime:
        runtime.reset({}, torch.Generator().manual_seed(0))
        runtime.run(act, 8)
        first = runtime.finish()
        runtime.reset({}, torch.Generator().manual_seed(0))
        runtime.run(act, 3)
        # A reset in the middle of an episode keeps that one as well.
        runtime.reset({}, torch.Generator().manual_seed(0))
        runtime.run(act, 5)
        last = runtime.finish()
    run = read_episodes(tmp_path / "run.mcap")
    assert run.complete
    assert [len(episode.outputs["agent"]) for episode in run.episodes] == [8, 3, 5]
    for expected, episode in ((first, run.episodes[0]), (last, run.episodes[2])):
        assert_same(expected, episode)
        assert expected.notes == episode.notes
    for episode in run.episodes:
        assert_replays(graph, episode)
    assert (run.origins[0] > 10**18) == (kind == "wall clock")


def test_a_writer_that_is_given_stays_open(tmp_path):
    graph = loop()
    with EpisodeWriter(tmp_path / "run.mcap", graph, {"robot": "rod"}) as writer:
        with ConcurrentRuntime(graph, record=writer) as runtime:
            runtime.reset({}, torch.Generator().manual_seed(0))
            runtime.run(act, 4)
        writer.note(0.07, "the rod is warm")
    run = read_episodes(tmp_path / "run.mcap")
    assert run.meta == {"robot": "rod"}
    assert [note.text for note in run.episodes[0].notes] == ["the rod is warm"]
    assert len(run.episodes[0].outputs["agent"]) == 4


@pytest.mark.parametrize(
    "make",
    [
        lambda graph, path: ConcurrentRuntime(graph, processes={"motor": 1}, beat_limit=AMPLE, record=path),
        lambda graph, path: WallClockRuntime(graph, beat_limit=AMPLE, record=path),
    ],
    ids=["processes", "wall clock"],
)
def test_a_failure_leaves_the_recording_of_what_had_run(tmp_path, make):
    graph, path = devices(tmp_path, "raise", at=12), tmp_path / "run.mcap"
    runtime = make(graph, path)
    runtime.reset({}, torch.Generator())
    with pytest.raises(NodeFailure):
        runtime.run(act, 1000)
    recorded = read_episodes(path)
    (episode,) = recorded.episodes
    cause = 'node "motor" at its tick 12: ValueError: encoder cable is off'
    assert not recorded.complete
    assert recorded.failures == {0: cause}
    last = episode.notes[-1]
    assert (last.level, last.node, last.text) == ("fatal", "motor", cause)
    assert last.t >= episode.t_start["agent"][-1]
    ended = runtime.finish()
    assert_same(ended, episode)
    assert (ended.notes, ended.failure) == (episode.notes, episode.failure)
    again = write_episodes(tmp_path / "again.mcap", graph, [ended])
    assert read_episodes(again).failures == {0: cause}
    timing = replay_timing(graph, episode.measured)
    for edge, connection in enumerate(graph.connections):
        np.testing.assert_array_equal(timing.windows_of(edge), episode.windows[connection.key])
    with pytest.raises(EpisodeFileError, match="exists; choose another name"):
        runtime.reset({}, torch.Generator())


@pytest.mark.parametrize("place", ["policy", "loop"])
def test_the_recording_says_that_an_error_of_the_caller_ended_the_episode(tmp_path, place):
    graph, path = loop(), tmp_path / "run.mcap"

    def policy(inputs):
        if int(inputs["sensor"].seq[0, -1]) >= 4:
            raise ZeroDivisionError("no gain")
        return act(inputs)

    def drive():
        with ConcurrentRuntime(graph, record=path) as runtime:
            for steps in (2, 100):  # the first episode ends well
                state, inputs = runtime.reset({}, torch.Generator().manual_seed(0))
                for _ in range(steps):
                    if place == "policy":
                        state = runtime.run(policy if steps == 100 else act, 1)
                    else:
                        state, inputs = runtime.step(state, policy(inputs) if steps == 100 else act(inputs))
                runtime.finish()

    with pytest.raises(ZeroDivisionError):
        drive()
    recorded = read_episodes(path)
    assert not recorded.complete
    assert recorded.failures == {1: "the caller stopped it: ZeroDivisionError: no gain"}
    assert [bool(episode.notes) for episode in recorded.episodes] == [False, True]


def test_ctrl_c_leaves_a_note_and_a_complete_recording(tmp_path):
    def policy(inputs):
        raise KeyboardInterrupt

    runtime = ConcurrentRuntime(loop(), record=tmp_path / "run.mcap")
    runtime.reset({}, torch.Generator())
    runtime.run(act, 3)
    with pytest.raises(KeyboardInterrupt):
        runtime.run(policy, 3)
    recorded = read_episodes(tmp_path / "run.mcap")
    assert recorded.complete
    assert [(note.level, note.text) for note in recorded.episodes[0].notes] == [
        ("warning", "the caller stopped it: KeyboardInterrupt")
    ]


def test_what_a_process_reported_outlives_it(tmp_path):
    path = tmp_path / "run.mcap"
    runtime = WallClockRuntime(devices(tmp_path, "die", at=25), beat_limit=AMPLE, record=path)
    runtime.reset({}, torch.Generator())
    with pytest.raises(NodeFailure, match="has died"):
        runtime.run(act, 1000)
    with pytest.raises(ValueError, match="lost with its process"):
        runtime.finish()
    recorded = read_episodes(path)
    motor = recorded.episodes[0].outputs["motor"]
    assert not recorded.complete
    assert re.match(r'node "motor" at its tick \d+: its process has died', recorded.failures[0])
    assert recorded.episodes[0].notes[-1].level == "fatal"
    assert 1 <= len(motor) <= 25  # of 0.5 s, all but the last reports
    assert motor[:, 0].tolist() == [k * (k + 1) / 2 for k in range(1, len(motor) + 1)]


SCRIPT = """
    import sys
    sys.path[:0] = {paths!r}
    import torch
    from live_nodes import act, devices
    from deepkoco.graph.live import WallClockRuntime
    if __name__ == "__main__":
        with WallClockRuntime(devices({folder!r}), record={folder!r} + "/run.mcap", beat_limit=30.0) as runtime:
            runtime.reset({{}}, torch.Generator())
            while True:
                state = runtime.run(act, 10)
                print(state.time[0], flush=True)
"""


@on_time
def test_a_killed_caller_leaves_what_ran_until_shortly_before(tmp_path):
    caller = start(SCRIPT, tmp_path)
    assert caller.stdout is not None
    for _ in range(4):
        now = float(caller.stdout.readline())
    # Reports take 20 ms to come and as long to be read; a busy machine more.
    time.sleep(0.5)
    caller.send_signal(signal.SIGKILL)
    caller.wait()
    caller.stdout.close()
    assert not (tmp_path / "run.mcap").exists()
    run = read_episodes(tmp_path / "run.mcap.partial", partial=True)
    assert not run.complete
    (episode,) = run.episodes
    for name in ("motor", "camera", "agent"):
        assert episode.t_end[name][-1] >= now - 0.02  # the step before that of `now`
        assert len(episode.outputs[name]) == len(episode.t_end[name])
    motor = episode.outputs["motor"]
    assert motor[:, 0].tolist() == [k * (k + 1) / 2 for k in range(1, len(motor) + 1)]
    # Of some nodes it knows more than of others; what it knows of all is whole and follows the rules.
    graph, part = devices(tmp_path), common_part(devices(tmp_path), episode)
    assert part.t_start["agent"][-1] >= now - 0.04
    timing = replay_timing(graph, part.measured)
    for edge, connection in enumerate(graph.connections):
        np.testing.assert_array_equal(timing.windows_of(edge), part.windows[connection.key])


def test_a_recording_that_cannot_be_written_is_refused_before_anything_runs(tmp_path):
    graph = loop()
    (tmp_path / "old.mcap").write_text("of another run")
    for record, match in ((tmp_path / "old.mcap", "exists"), (tmp_path / "run.npz", "ends in .mcap")):
        with pytest.raises(EpisodeFileError, match=match):
            ConcurrentRuntime(graph, record=record)
    with (
        EpisodeWriter(tmp_path / "run.mcap", loop()) as writer,
        pytest.raises(EpisodeFileError, match="another graph"),
    ):
        ConcurrentRuntime(graph, record=writer)


def test_a_writer_that_fails_does_not_stop_the_run(tmp_path):
    graph = loop()
    writer = EpisodeWriter(tmp_path / "run.mcap", graph)
    runtime = ConcurrentRuntime(graph, record=writer)
    runtime.reset({}, torch.Generator().manual_seed(0))
    runtime.run(act, 2)
    writer.close()
    runtime.run(act, 8)
    assert len(runtime.finish().outputs["agent"]) == 10
    with pytest.raises(EpisodeFileError, match="the writer is closed"):
        runtime.close()
