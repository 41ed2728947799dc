"""Real time: every tick once, by the rules, recorded as it was."""

import time

import numpy as np
import pytest
import torch
from live_nodes import AMPLE, Timed, act, loop

from deepkoco.graph import Connection, Episode, Graph, Supervisor, replay_episode
from deepkoco.graph.live import WallClockRuntime, message_times, node_times
from tests.graph.timing_reference import Accumulate
from tests.on_time import on_time


def recorded(graph: Graph, steps: int, **options) -> Episode:
    with WallClockRuntime(graph, time_limit=AMPLE, beat_limit=AMPLE, **options) as runtime:
        runtime.reset({}, torch.Generator().manual_seed(0))
        runtime.run(act, steps)
        return runtime.finish()


def assert_replays(graph: Graph, episode: Episode) -> None:
    again, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(0))
    for key, seen in episode.windows.items():
        np.testing.assert_array_equal(seen, again.windows[key])
    for name, outputs in episode.outputs.items():
        np.testing.assert_array_equal(outputs, again.outputs[name])


@pytest.mark.parametrize("blocking", [False, True])
def test_a_run_in_processes_replays_bitwise(blocking):
    graph = loop(blocking=blocking)
    episode = recorded(graph, 20)
    assert len(episode.outputs["agent"]) == 20
    assert_replays(graph, episode)


def test_rates_that_are_no_whole_nanoseconds_replay_bitwise_too():
    graph = loop(rate=60, agent_rate=30)
    assert_replays(graph, recorded(graph, 12, threads=("world", "sensor", "actuator")))


class Slow(Timed):
    """Takes 25 ms at tick 3, as long as two and a half of its periods, and counts its steps."""

    def __init__(self, name, rate, **options):
        super().__init__(name, rate, **options)
        self.steps = 0

    def step(self, parameters, state, inputs):
        if self.steps == 3:
            time.sleep(0.025)
        self.steps += 1
        return super().step(parameters, state, inputs)


@pytest.mark.parametrize("scheduling", ["frequency", "phase"])
@on_time
def test_each_tick_runs_once_and_an_overrun_shifts_or_is_caught_up(scheduling):
    slow = Slow("slow", 100, scheduling=scheduling)
    agent = Supervisor("agent", 50, initial_action=torch.zeros(2, dtype=torch.float64))
    graph = Graph([slow, agent], [Connection("slow", "agent")])
    episode = recorded(graph, 10, threads=("slow",))
    start, end = episode.t_start["slow"], episode.t_end["slow"]
    # Steps that had started when the agent took its last step; one more may have come before the end.
    assert slow.steps - len(start) in (0, 1)
    assert (start[1:] >= end[:-1]).all()
    ticks = np.arange(len(start)) * 0.01
    assert (start >= ticks).all()
    times = node_times(graph, episode, "slow")
    assert times.overruns >= 1
    assert any(note.node == "slow" and "longer than a period" in note.text for note in episode.notes)
    assert times.steps == len(start)
    if scheduling == "frequency":
        # What the overrun took stays: all later ticks are 15 ms or more behind.
        assert (start[4:] >= ticks[4:] + 0.015).all()
        assert (times.lateness >= -1e-9).all()
    else:
        # Ticks 4 and 5 fell into the overrun; those after it come at their own times again.
        assert (start[6:] - ticks[6:]).min() < 0.015
    assert_replays(graph, episode)


def test_messages_are_counted_as_sent_lost_and_unseen():
    # 100 Hz into 25 Hz: of four messages the window of one shows the last.
    agent = Supervisor("agent", 25, initial_action=torch.zeros(2, dtype=torch.float64))
    graph = Graph([Accumulate("fast", 100), agent], [Connection("fast", "agent")])
    episode = recorded(graph, 5, threads=("fast",))
    counted = message_times(graph, episode, "fast->agent")
    seen = {int(seq) for seq in episode.windows["fast->agent"].ravel() if seq >= 0}
    assert counted.sent == len(episode.t_start["fast"])
    assert counted.lost == 0
    assert counted.unseen == max(seen) + 1 - len(seen)
    assert counted.unseen >= 5
    assert (counted.delay > 0).all()


def test_the_fate_of_messages_by_hand():
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1), phase=0)
    graph = Graph([Accumulate("n", 20), agent], [Connection("n", "agent")])
    sent = np.arange(7) * 0.05
    received = sent + 0.01
    received[[1, 6]] = np.inf  # message 1 got lost, message 6 is under way at the end
    episode = Episode(
        t_start={"n": sent, "agent": np.array([0.0, 0.1, 0.2, 0.3])},
        t_end={"n": sent, "agent": np.array([0.0, 0.13, 0.35, 0.3])},
        outputs={},
        t_sent={"n->agent": sent},
        t_received={"n->agent": received},
        windows={"n->agent": np.array([[-1], [0], [3], [5]])},
    )
    counted = message_times(graph, episode, "n->agent")
    assert (counted.sent, counted.lost, counted.unseen) == (7, 1, 2)  # 2 and 4 were passed over
    np.testing.assert_allclose(counted.delay, 0.01)
    times = node_times(graph, episode, "agent")
    assert times.overruns == 1  # the step of 150 ms
    # Frequency scheduling: the 50 ms that step 2 took too long move tick 3 to 0.35 s.
    np.testing.assert_allclose(times.lateness, [0, 0, 0, -0.05], atol=1e-12)
    np.testing.assert_allclose(times.computation, [0, 0.03, 0.15])


def test_real_time_takes_no_drawn_timing():
    from deepkoco.graph import draw_timing

    graph = loop()
    runtime = WallClockRuntime(graph)
    with pytest.raises(ValueError, match="its delays are real"):
        runtime.reset({}, torch.Generator(), timing=draw_timing(graph, np.random.default_rng(0), 2, 1))
