"""The simulated runtime equals the batched one bit for bit, and takes nodes that are not pure."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from live_nodes import act, assert_same, devices, loop, run

from deepkoco.graph import (
    BatchedRuntime,
    Connection,
    Graph,
    HorizonError,
    Node,
    Supervisor,
    draw_timing,
    record_episodes,
)
from deepkoco.graph.live import NodeFailure, SimulatedRuntime
from tests.graph.timing_reference import graphs


@settings(max_examples=40, deadline=None)
@given(graph=graphs(), steps=st.integers(1, 5))
def test_an_episode_equals_the_batched_one_bitwise(graph, steps):
    timing = draw_timing(graph, np.random.default_rng(0), steps, 1)
    generator = torch.Generator().manual_seed(0)
    batched, state = record_episodes(BatchedRuntime(graph, timing), act, {}, generator)
    runtime = SimulatedRuntime(graph, timing)
    runtime.reset({}, torch.Generator().manual_seed(0))
    runtime.run(act, steps)
    for name, values in state.nodes.items():
        for key, value in values.items():
            assert torch.equal(value, runtime.node_state(name)[key])
    assert_same(batched[0], runtime.finish())


class Watcher(Supervisor):
    """Reads out how much the action and what it sees are, and counts."""

    def init(self, parameters, generator, batch):
        return {"n": torch.zeros(batch, dtype=torch.int64)}

    def observe(self, parameters, state, inputs, action):
        total = inputs["n0"].data.sum((1, 2)) * parameters["gain"] + action.sum(1)
        return {"n": state["n"] + 1}, {"total": total, "n": state["n"]}


def test_states_and_readings_read_like_the_batched_runtimes():
    from tests.graph.timing_reference import Accumulate

    action = torch.tensor([0.25, 0.5], dtype=torch.float64)
    graph = Graph(
        [Accumulate("n0", 30), Watcher("agent", 20, initial_action=action)],
        [Connection("n0", "agent", 0.01), Connection("agent", "n0", skip=True)],
    )
    timing = draw_timing(graph, np.random.default_rng(0), 3, 1)
    parameters = {"agent": {"gain": torch.tensor(2.0, dtype=torch.float64)}}
    initial = {"n0": {"x": torch.ones(1, 2, dtype=torch.float64)}}
    batched, simulated = BatchedRuntime(graph, timing), SimulatedRuntime(graph, timing)
    first, _ = batched.reset(parameters, torch.Generator().manual_seed(1), initial)
    second, _ = simulated.reset(parameters, torch.Generator().manual_seed(1), initial)
    for k in range(4):
        assert (first.step, first.steps_left) == (second.step, second.steps_left) == ([k], [3 - k])
        np.testing.assert_array_equal(first.time, second.time)
        assert first.readings.keys() == second.readings.keys() == {"total", "n"}
        assert all(torch.equal(first.readings[key], second.readings[key]) for key in first.readings)
        if k < 3:
            first, _ = batched.step(first, action[None] * k)
            second, _ = simulated.step(second, action[None] * k)
    with pytest.raises(HorizonError, match="all 3 supervisor steps"):
        simulated.step(second, action[None])


def test_by_the_protocol_an_episode_has_no_end():
    runtime = SimulatedRuntime(loop())
    runtime.reset({}, torch.Generator().manual_seed(0))
    state = runtime.run(act, 300)
    assert state.time[0] == 6.0
    episode = runtime.finish()
    # Nodes at 100 Hz until the agent's tick at 6 s: the sensor comes before it, the actuator after it.
    counts = {name: len(values) for name, values in episode.outputs.items()}
    assert counts == {"world": 601, "sensor": 601, "agent": 300, "actuator": 600}


class Clocked(Node):
    """Notes on a board that it shares with others when it ran; not pure."""

    pure = False

    def __init__(self, name, rate, board):
        super().__init__(name, rate)
        self.board = board

    def init(self, parameters, generator, batch):
        return {}

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1)

    def step(self, parameters, state, inputs):
        (seen,) = inputs.values()
        self.board.append((float(seen.t_start), self.name))
        return state, torch.zeros(1, 1)


def test_nodes_that_share_an_engine_step_in_the_order_of_time():
    board = []
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1))
    graph = Graph(
        [Clocked("motor", 100, board), Clocked("camera", 30, board), agent],
        [
            Connection("agent", "motor", skip=True),
            Connection("motor", "camera"),
            Connection("camera", "agent"),
        ],
    )
    timing = draw_timing(graph, np.random.default_rng(0), 5, 1)
    run(SimulatedRuntime(graph, timing), 0)
    with SimulatedRuntime(graph, timing) as runtime:
        board.clear()
        runtime.reset({}, torch.Generator())
        runtime.run(lambda _: torch.zeros(1, 1), 5)
    assert len(board) > 60
    assert board == sorted(board, key=lambda entry: entry[0])
    # Where both run at one instant, the camera sees the motor's step: it comes second.
    assert board[:2] == [(0.0, "motor"), (0.0, "camera")]


def test_nodes_are_opened_once_and_closed_once(tmp_path):
    graph = devices(tmp_path)
    timing = draw_timing(graph, np.random.default_rng(0), 4, 1)
    with SimulatedRuntime(graph, timing) as runtime:
        for _ in range(2):
            runtime.reset({}, torch.Generator())
            runtime.run(act, 4)
        episode = runtime.finish()
        runtime.close()
    assert [len(graph.node("motor").marks(what)) for what in ("open", "close")] == [1, 1]
    # The motor writes into the same memory at each step; what was sent stays what it was.
    assert episode.outputs["motor"][:4, 0].tolist() == [1, 3, 6, 10]


@pytest.mark.parametrize("fault", ["nan", "raise", "bad close"])
def test_a_node_that_fails_is_named_and_all_are_closed(tmp_path, fault):
    graph = devices(tmp_path, fault)
    runtime = SimulatedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 9, 1))
    runtime.reset({}, torch.Generator())
    if fault != "bad close":
        reason = {"raise": "ValueError: encoder", "nan": r"NotFiniteError: output entry \[1\] is nan"}[fault]
        with pytest.raises(NodeFailure, match=f'node "motor" at its tick 3: {reason}') as caught:
            runtime.run(act, 9)
        assert (caught.value.node, caught.value.tick) == ("motor", 3)
        assert {"raise": "raise_error", "nan": "check_finite"}[fault] in caught.value.details
    else:
        with pytest.raises(NodeFailure, match=r'node "motor".*OSError: the drive'):
            runtime.close()
    assert all(len(graph.node(name).marks("close")) == 1 for name in ("motor", "camera"))
    with pytest.raises(ValueError, match="reset first"):
        runtime.run(act, 1)


@pytest.mark.parametrize("time_limit", [None, 10.0])
def test_an_action_that_is_not_finite_closes_all_nodes(tmp_path, time_limit):
    graph = devices(tmp_path)
    runtime = SimulatedRuntime(graph, time_limit=time_limit)
    state, _ = runtime.reset({}, torch.Generator())
    with pytest.raises(
        NodeFailure, match=r'node "agent" at its tick 0: NotFiniteError: action entry \[1\] is nan'
    ):
        runtime.step(state, torch.tensor([[0.0, torch.nan]], dtype=torch.float64))
    assert [len(graph.node(name).marks("close")) for name in ("motor", "camera")] == [1, 1]


def test_a_node_that_never_returns_is_given_up(tmp_path):
    graph = devices(tmp_path, "hang")
    timing = draw_timing(graph, np.random.default_rng(0), 9, 1)
    runtime = SimulatedRuntime(graph, timing, time_limit=0.5)
    runtime.reset({}, torch.Generator())
    with pytest.raises(NodeFailure, match=r'node "motor" at its tick 3: has not returned for 0\.5 s'):
        runtime.run(act, 9)
    assert all(len(graph.node(name).marks("close")) == 1 for name in ("motor", "camera"))


def test_ctrl_c_closes_the_nodes_and_says_where_it_came(tmp_path):
    graph = devices(tmp_path, "ctrl-c")
    runtime = SimulatedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 9, 1))
    runtime.reset({}, torch.Generator())
    with pytest.raises(KeyboardInterrupt, match='in node "motor" at its tick 3'):
        runtime.run(act, 9)
    assert all(len(graph.node(name).marks("close")) == 1 for name in ("motor", "camera"))


def test_with_a_time_limit_the_result_is_the_same():
    graph = loop()
    timing = draw_timing(graph, np.random.default_rng(0), 5, 1)
    assert_same(
        run(SimulatedRuntime(graph, timing), 5), run(SimulatedRuntime(graph, timing, time_limit=5), 5)
    )


def test_mistakes_of_the_caller_leave_the_nodes_running():
    graph = loop()
    runtime = SimulatedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 4, 1))
    state, inputs = runtime.reset({}, torch.Generator())
    with pytest.raises(ValueError, match='action of "agent" at its step 0 has shape \\(1, 3\\)'):
        runtime.step(state, torch.zeros(1, 3))
    later, _ = runtime.step(state, act(inputs))
    with pytest.raises(ValueError, match="stepped already"):
        runtime.step(state, act(inputs))
    runtime.step(later, act(inputs))
    with pytest.raises(ValueError, match='"wheel" is no node'):
        runtime.reset({"wheel": {}}, torch.Generator())
    with pytest.raises(ValueError, match=r'initial "world\.v"'):
        runtime.reset({}, torch.Generator(), {"world": {"v": torch.zeros(1)}})
