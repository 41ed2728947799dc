"""A graph over two ends runs, records and replays like one of a single machine, and stops when either end does."""

import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from live_nodes import act, assert_same, loop
from two_ends import AMPLE, Cable, Serving, leading, marks, motor_graph, push

from deepkoco.graph import read_episodes, replay_episode
from deepkoco.graph.episodes.storage.container import EpisodeFileError
from deepkoco.graph.live import NodeFailure, message_times
from deepkoco.graph.net import ConnectionRefused, LinkFailure, merge_recordings
from tests.on_time import on_time

TESTS = Path(__file__).parents[1]


def assert_replays(graph, episode):
    again, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(0))
    for key, seen in episode.windows.items():
        np.testing.assert_array_equal(seen, again.windows[key])
    for name, outputs in episode.outputs.items():
        np.testing.assert_array_equal(outputs, again.outputs[name])


@pytest.mark.parametrize("robot", [("world", "actuator"), ("world", "sensor", "actuator"), ("sensor",)])
def test_a_run_over_two_ends_replays_bitwise_wherever_the_cut_goes(robot):
    graph = loop()
    with Serving(loop(), robot) as serving, leading(graph, serving.address) as runtime:
        runtime.reset({}, torch.Generator().manual_seed(0))
        runtime.run(act, 15)
        episode = runtime.finish()
    assert len(episode.outputs["agent"]) == 15
    assert all(message_times(graph, episode, c.key).lost == 0 for c in graph.connections)
    assert_replays(graph, episode)


def test_the_motor_rests_after_an_episode_and_moves_in_the_next(tmp_path):
    graph = motor_graph(tmp_path)
    with Serving(motor_graph(tmp_path), ["motor"]) as serving, leading(graph, serving.address) as runtime:
        for number in range(2):
            runtime.reset({}, torch.Generator())
            runtime.run(push, 3)
            assert len(marks(tmp_path, "rest")) == number
            runtime.finish()
            assert len(marks(tmp_path, "rest")) == number + 1
    assert len(marks(tmp_path, "open")) == len(marks(tmp_path, "close")) == 1


def soon(lead):
    """What leads, once the robot's end has done with the leader before."""
    until = time.monotonic() + AMPLE
    while True:
        try:
            return lead()
        except ConnectionRefused:
            if time.monotonic() > until:
                raise
            time.sleep(0.01)


def test_a_runtime_that_never_began_lets_go_of_the_robot(tmp_path):
    graph, taken = loop(), tmp_path / "taken.mcap"
    taken.write_bytes(b"")
    with Serving(loop(), ["world", "actuator"], sessions=None) as serving:
        soon(lambda: leading(graph, serving.address)).close()
        with pytest.raises(EpisodeFileError):
            soon(lambda: leading(graph, serving.address, record=taken))
        with soon(lambda: leading(graph, serving.address)) as runtime:
            runtime.reset({}, torch.Generator().manual_seed(0))
            runtime.run(act, 3)
            assert len(runtime.finish().outputs["agent"]) == 3


def test_nodes_in_processes_of_both_ends_run_too(tmp_path):
    graph = loop()
    with Serving(loop(), ["world", "actuator"], threads=()) as serving:
        runtime = leading(graph, serving.address)
        with runtime:
            runtime.reset({}, torch.Generator().manual_seed(0))
            runtime.run(act, 10)
            assert_replays(graph, runtime.finish())


def test_parameters_and_draws_reach_the_robot_as_in_one_process(tmp_path):
    class Draws(type(motor_graph(tmp_path).node("motor"))):
        def init(self, parameters, generator, batch):
            super().init(parameters, generator, batch)
            return {
                "start": parameters["gain"] * torch.rand(batch, 1, generator=generator, dtype=torch.float64)
            }

        def step(self, parameters, state, inputs):
            return state, state["start"]

    graph = motor_graph(tmp_path)
    graph.nodes[0].__class__ = Draws
    with Serving(graph, ["motor"]) as serving, leading(motor_graph(tmp_path), serving.address) as runtime:
        runtime.reset({"motor": {"gain": torch.tensor(3.0)}}, torch.Generator().manual_seed(5))
        runtime.run(push, 4)
        first = float(runtime.finish().outputs["motor"][0, 0])
    drawn = torch.rand(1, 1, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    assert first == float(torch.tensor(3.0) * drawn)


def test_the_recording_is_whole_and_so_is_the_merged_one(tmp_path):
    graph = motor_graph(tmp_path)
    with Serving(motor_graph(tmp_path), ["motor"], record=tmp_path / "robot") as serving:
        with leading(graph, serving.address, record=tmp_path / "leader.mcap") as runtime:
            for _ in range(2):
                runtime.reset({}, torch.Generator())
                runtime.run(push, 8)
                episode = runtime.finish()
        serving.thread.join()
    run = read_episodes(tmp_path / "leader.mcap")
    assert run.complete
    assert run.meta["robot_nodes"] == ["motor"]
    assert_same(run.episodes[1], episode)
    own = read_episodes(tmp_path / "robot" / "session_0000.mcap")
    assert own.origins == run.origins
    assert len(own.episodes[1].t_start["agent"]) == 0
    count = len(episode.t_start["motor"])
    np.testing.assert_array_equal(own.episodes[1].t_start["motor"][:count], episode.t_start["motor"])
    merged = merge_recordings(tmp_path / "leader.mcap", own.path, tmp_path / "merged.mcap")
    assert_same(read_episodes(merged).episodes[1], episode)


@on_time
def test_a_cut_cable_leaves_the_motor_safe_within_100_ms_and_both_records_merge(tmp_path):
    graph = motor_graph(tmp_path)
    serving = Serving(motor_graph(tmp_path), ["motor"], silence=0.06, record=tmp_path / "robot")
    with serving, Cable(serving.address) as cable:
        runtime = leading(graph, cable.address, 0.06, record=tmp_path / "leader.mcap")
        runtime.reset({}, torch.Generator())
        runtime.run(push, 20)
        cable.cut()
        with pytest.raises(NodeFailure, match="the other end has been silent for"):
            runtime.run(push, 1000)
        serving.thread.join()
        assert marks(tmp_path, "close")[0] - cable.cut_at < 0.1
    assert "nodes closed within" in serving.said[-1]
    with pytest.raises(ValueError, match='the record of "motor" is lost'):
        runtime.finish()
    merged = merge_recordings(
        tmp_path / "leader.mcap", tmp_path / "robot" / "session_0000.mcap", tmp_path / "merged.mcap"
    )
    run = read_episodes(merged)
    assert "silent" in run.failures[0]
    assert 15 <= len(run.episodes[0].outputs["agent"]) <= 30
    for name, times in run.episodes[0].t_start.items():
        assert len(times) > 10, name
    assert_replays(graph, run.episodes[0])


@on_time
def test_a_policy_that_hangs_leaves_the_motor_safe_though_the_connection_lives(tmp_path):
    graph = motor_graph(tmp_path)
    with Serving(motor_graph(tmp_path), ["motor"], silence=0.06) as serving:
        runtime = leading(graph, serving.address)
        runtime.reset({}, torch.Generator())
        runtime.run(push, 10)
        last = time.monotonic()
        while not marks(tmp_path, "close") and time.monotonic() - last < 5.0:
            time.sleep(0.002)
        assert marks(tmp_path, "close")[0] - last < 0.1
        with pytest.raises(NodeFailure, match=r"agent->motor: no message for \d+ ms, and 70 ms is the limit"):
            runtime.finish()


def test_nothing_moves_again_by_itself_and_a_new_reset_connects_anew(tmp_path):
    graph = motor_graph(tmp_path)
    serving = Serving(motor_graph(tmp_path), ["motor"], sessions=2, silence=0.5)
    with serving, Cable(serving.address) as cable:
        runtime = leading(graph, cable.address, 0.5)
        runtime.reset({}, torch.Generator())
        runtime.run(push, 3)
        cable.cut()
        until = time.monotonic() + AMPLE
        while not marks(tmp_path, "close") and time.monotonic() < until:
            time.sleep(0.01)
        cable.mend()
        time.sleep(0.2)
        assert len(marks(tmp_path, "open")) == 1
        with pytest.raises(NodeFailure):
            runtime.finish()
        runtime.reset({}, torch.Generator())
        runtime.run(push, 3)
        assert len(runtime.finish().outputs["agent"]) == 3
        runtime.close()
        assert len(marks(tmp_path, "open")) == 2


def test_a_node_that_fails_at_the_robot_is_named_at_the_other_end(tmp_path):
    graph = motor_graph(tmp_path)
    named = r'node "motor" at its tick 4: \(at .*encoder cable is off'
    robot = Serving(motor_graph(tmp_path, fault_at=4), ["motor"])
    with robot as serving, leading(graph, serving.address) as runtime:
        runtime.reset({}, torch.Generator())
        with pytest.raises(NodeFailure, match=named) as caught:
            runtime.run(push, 1000)
        assert "ValueError" in caught.value.details
        episode = runtime.finish()  # the robot has sent its record when it parted
    assert len(episode.outputs["motor"]) == 4
    assert "encoder cable is off" in episode.failure


def test_ctrl_c_at_the_robot_stops_both_and_keeps_the_record(tmp_path):
    graph = motor_graph(tmp_path)
    with Serving(motor_graph(tmp_path), ["motor"]) as serving, leading(graph, serving.address) as runtime:
        runtime.reset({}, torch.Generator())
        runtime.run(push, 5)
        serving.end.close()
        with pytest.raises(LinkFailure, match="has stopped: the robot's end was stopped"):
            runtime.run(push, 10_000)
        assert len(runtime.finish().outputs["agent"]) >= 5


KILLED = textwrap.dedent(
    """
    import sys, torch
    sys.path[:0] = [{tests!r} + "/net", {tests!r} + "/live", {tests!r}]
    from two_ends import leading, motor_graph, push
    runtime = leading(motor_graph({folder!r}), {address!r})
    runtime.reset({{}}, torch.Generator())
    runtime.run(push, 20)
    print("runs", flush=True)
    runtime.run(push, 100_000)
    """
)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@on_time
def test_who_leads_is_killed_or_stands_still_and_the_motor_is_safe_within_100_ms(tmp_path, number):
    with Serving(motor_graph(tmp_path), ["motor"], silence=0.06) as serving:
        text = KILLED.format(tests=str(TESTS), folder=str(tmp_path), address=serving.address)
        child = subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE)
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == b"runs\n", serving.said
            killed = time.monotonic()
            child.send_signal(number)
            serving.thread.join(10.0)
            assert marks(tmp_path, "close")[0] - killed < 0.1
        finally:
            child.kill()
            child.communicate()
    why = "closed by the other end|broken" if number == signal.SIGKILL else "silent|no message"
    assert any(word in serving.said[-1] for word in why.split("|")), serving.said
