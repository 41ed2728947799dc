"""Threads and processes give what the simulated runtime gives, bit for bit, however fast they run."""

import math
import pickle
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from live_nodes import AMPLE, Timed, act, assert_same, devices, loop, run

from deepkoco.graph import (
    BatchedRuntime,
    Connection,
    Gaussian,
    Graph,
    GraphError,
    HorizonError,
    Supervisor,
    draw_timing,
    record_episodes,
    replay_episode,
    replay_timing,
)
from deepkoco.graph.live import ConcurrentRuntime, SimulatedRuntime
from tests.graph.timing_reference import Accumulate, graphs


@settings(max_examples=15, deadline=None)
@given(graph=graphs(), steps=st.integers(1, 5), factor=st.sampled_from([math.inf, math.inf, 30.0]))
def test_threads_equal_the_simulated_runtime_bitwise(graph, steps, factor):
    timing = draw_timing(graph, np.random.default_rng(0), steps, 1)
    expected = run(SimulatedRuntime(graph, timing), steps)
    assert_same(expected, run(ConcurrentRuntime(graph, timing, real_time_factor=factor), steps))


@pytest.mark.parametrize("factor", [math.inf, 4.0])
def test_processes_equal_the_simulated_runtime_bitwise(factor):
    graph = loop()
    delays = {"world->sensor": Gaussian(0.004, 0.004), "sensor": Gaussian(0.003, 0.002)}
    timing = draw_timing(graph, np.random.default_rng(0), 20, 1, delays)
    expected = run(SimulatedRuntime(graph, timing), 20)
    # One node in a process of its own, two that share one, both reached from here.
    processes = {"world": 1, "sensor": 2, "actuator": 2}
    with ConcurrentRuntime(
        graph, timing, processes=processes, real_time_factor=factor, beat_limit=AMPLE
    ) as runtime:
        for _ in range(2):  # the processes stay for the next episode
            runtime.reset({}, torch.Generator().manual_seed(0))
            runtime.run(act, 20)
            assert_same(expected, runtime.finish())


def test_messages_that_are_lost_are_lost_in_every_runtime():
    graph = loop()
    lossy = {"sensor->agent": {"law": "lossy", "delay": 0.002, "probability": 0.4}}
    timing = draw_timing(graph, np.random.default_rng(0), 20, 1, lossy)
    generator = torch.Generator().manual_seed(0)
    expected = record_episodes(BatchedRuntime(graph, timing), act, {}, generator)[0][0]
    assert np.isinf(expected.t_received["sensor->agent"]).sum() > 3
    assert_same(expected, run(SimulatedRuntime(graph, timing), 20))
    assert_same(expected, run(ConcurrentRuntime(graph, timing), 20))


def test_by_the_protocol_runs_equal_the_simulated_ones_without_any_horizon():
    graph = loop()
    expected = run(SimulatedRuntime(graph), 60)
    assert_same(expected, run(ConcurrentRuntime(graph, processes={"sensor": 1}, beat_limit=AMPLE), 60))


def test_an_episode_by_the_protocol_replays_bitwise_in_every_runtime():
    graph = loop()
    episode = run(ConcurrentRuntime(graph, processes={"sensor": 1}, beat_limit=AMPLE), 20)
    again, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(0))
    assert_same(episode, again)
    timing = replay_timing(graph, episode.measured, windows=episode.windows)
    assert_same(episode, run(SimulatedRuntime(graph, timing), 20))
    assert_same(episode, run(ConcurrentRuntime(graph, timing, processes={"sensor": 1}, beat_limit=AMPLE), 20))


def test_a_new_timing_can_come_with_each_reset_in_the_middle_of_an_episode():
    graph = loop()
    runtime = ConcurrentRuntime(graph, draw_timing(graph, np.random.default_rng(0), 50, 1))
    fresh = draw_timing(graph, np.random.default_rng(1), 4, 1, {"world->sensor": Gaussian(0.01, 0.01)})
    with runtime:
        runtime.reset({}, torch.Generator().manual_seed(0))
        runtime.run(act, 7)
        runtime.reset({}, torch.Generator().manual_seed(3), timing=fresh)
        state = runtime.run(act, 4)
        with pytest.raises(HorizonError):
            runtime.step(state, torch.zeros(1, 2, dtype=torch.float64))
        runtime.reset({}, torch.Generator().manual_seed(3), timing=fresh)
        runtime.run(act, 4)
        assert_same(run(SimulatedRuntime(graph, fresh), 4, seed=3), runtime.finish())


def test_the_real_time_factor_is_kept():
    graph = loop()
    timing = draw_timing(graph, np.random.default_rng(0), 10, 1)
    with ConcurrentRuntime(graph, timing, real_time_factor=2.0) as runtime:
        begin = time.monotonic()
        runtime.reset({}, torch.Generator())
        runtime.run(act, 10)
        # Ten steps of the agent are 200 ms, at factor 2 at least 100 ms; no step may come before its time.
        assert time.monotonic() - begin > 0.099


class Counter(Accumulate):
    """Counts its steps where others can see it."""

    def __init__(self, name, rate):
        super().__init__(name, rate)
        self.steps = 0

    def step(self, parameters, state, inputs):
        self.steps += 1
        return super().step(parameters, state, inputs)


def test_a_source_that_needs_no_action_does_not_run_ahead_without_end():
    source = Counter("source", 100)
    agent = Supervisor("agent", 50, initial_action=torch.zeros(2, dtype=torch.float64))
    graph = Graph([source, agent], [Connection("source", "agent")])
    with ConcurrentRuntime(graph) as runtime:
        runtime.reset({}, torch.Generator())
        runtime.run(act, 5)
        # The agent waits at its step 5; the source may be two of its steps ahead: ticks 0 to 14.
        deadline = time.monotonic() + AMPLE
        while source.steps < 11 and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(0.05)
        assert 11 <= source.steps <= 15


def make_sensor():
    return Timed("sensor", 100)


def test_a_node_that_does_not_travel_is_named_and_a_factory_takes_its_place():
    graph = loop()
    graph.node("sensor").lock = threading.Lock()  # type: ignore[attr-defined]
    timing = draw_timing(graph, np.random.default_rng(0), 5, 1)
    with (
        pytest.raises(GraphError, match=r'node "sensor" does not travel.*factories='),
        ConcurrentRuntime(graph, timing, processes={"sensor": 1}, beat_limit=AMPLE) as runtime,
    ):
        runtime.reset({}, torch.Generator())
    made = ConcurrentRuntime(
        graph, timing, processes={"sensor": 1}, beat_limit=AMPLE, factories={"sensor": make_sensor}
    )
    assert_same(run(SimulatedRuntime(graph, timing), 5), run(made, 5))


def test_wrong_names_and_states_are_refused_and_leave_the_runtime_usable():
    graph = loop()
    with pytest.raises(GraphError, match='"wheel" is no node'):
        ConcurrentRuntime(graph, processes={"wheel": 1})
    with pytest.raises(GraphError, match='supervisor "agent" stays'):
        ConcurrentRuntime(graph, processes={"agent": 1})
    with pytest.raises(ValueError, match="finite real_time_factor"):
        ConcurrentRuntime(graph, sync=False)
    with pytest.raises(ValueError, match="factor 0 is not positive"):
        ConcurrentRuntime(graph, real_time_factor=0)
    with ConcurrentRuntime(graph) as runtime:
        with pytest.raises(ValueError, match=r'initial "world\.v"'):
            runtime.reset({}, torch.Generator(), {"world": {"v": torch.zeros(1)}})
        state, inputs = runtime.reset({}, torch.Generator())
        with pytest.raises(ValueError, match='action of "agent" at its step 0 has shape'):
            runtime.step(state, torch.zeros(1, 3))
        runtime.step(state, act(inputs))


def test_nodes_open_and_close_where_they_step(tmp_path):
    graph = devices(tmp_path)
    motor, camera = graph.node("motor"), graph.node("camera")
    run(ConcurrentRuntime(graph, processes={"motor": 1}, beat_limit=AMPLE), 3)
    assert motor.marks("open") == motor.marks("close")
    assert camera.marks("open") == camera.marks("close")
    process = [node.marks("open")[0].split()[0] for node in (motor, camera)]
    assert process[0] != process[1]


def test_an_asynchronous_episode_keeps_its_delays_and_replays_bitwise():
    graph = loop()
    runtime = ConcurrentRuntime(graph, real_time_factor=2.0, sync=False)
    episode = run(runtime, 15)
    for key, delay in {"world->sensor": 0.001, "sensor->agent": 0.002, "actuator->world": 0.0}.items():
        arrived = np.isfinite(episode.t_received[key])
        age = episode.t_received[key][arrived] - episode.t_sent[key][arrived]
        assert (age > delay - 1e-12).all()
    again, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(0))
    for name, outputs in episode.outputs.items():
        np.testing.assert_array_equal(outputs, again.outputs[name])


def test_an_asynchronous_run_loses_messages_as_its_laws_say():
    graph = loop()
    connections = [
        replace(c, delay={"law": "lossy", "delay": 0.002, "probability": 0.5}) if c.receiver == "agent" else c
        for c in graph.connections
    ]
    graph = Graph(graph.nodes, connections)
    episode = run(ConcurrentRuntime(graph, real_time_factor=4.0, sync=False, seed=1), 30)
    lost = np.isinf(episode.t_received["sensor->agent"])
    assert 10 < lost.sum() < len(lost) - 10
    assert not np.isin(np.flatnonzero(lost), episode.windows["sensor->agent"]).any()
    assert any("did not arrive" in note.text for note in episode.notes)


def test_messages_travel_as_plain_numbers():
    from deepkoco.graph.live.message import Message, decode, encode

    for data in (torch.rand(1, 2, 3), torch.tensor([True]), torch.arange(4)[None], torch.zeros(1, 0)):
        frame = encode(Message(1, 2, 3, 4, 5, data))
        with pytest.raises(pickle.UnpicklingError):
            pickle.loads(frame)
        back = decode(frame)
        assert back[:5] == (1, 2, 3, 4, 5)
        assert back.data.dtype == data.dtype
        assert torch.equal(back.data, data)
    with pytest.raises(TypeError, match="bfloat16"):
        encode(Message(0, 0, 0, 0, 0, torch.zeros(1, dtype=torch.bfloat16)))


def test_by_the_clock_nobody_waits_for_messages_that_get_lost():
    agent = Supervisor("agent", 50, initial_action=torch.zeros(2, dtype=torch.float64))
    lossy = {"law": "lossy", "delay": 0.001, "probability": 0.5}
    graph = Graph([Accumulate("n", 100), agent], [Connection("n", "agent", lossy, blocking=True)])
    with pytest.raises(ValueError, match='connection "n->agent" blocks and loses messages'):
        ConcurrentRuntime(graph, sync=False, real_time_factor=1.0)
    timing = draw_timing(graph, np.random.default_rng(0), 10, 1)
    assert_same(run(SimulatedRuntime(graph, timing), 10), run(ConcurrentRuntime(graph, timing), 10))
