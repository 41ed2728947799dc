"""Outputs, states and actions that do not match are refused with node, step and both shapes, in every runtime."""

import math
import warnings

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.graph import (
    BatchedRuntime,
    ConcurrentRuntime,
    Connection,
    Graph,
    GraphError,
    Node,
    NodeFailure,
    SimulatedRuntime,
    StepError,
    Supervisor,
    WallClockRuntime,
    draw_timing,
)
from deepkoco.graph.model.contract import NotFiniteError, check_finite


class Faulty(Node):
    """Breaks the contract in one way: what it starts with, or what its first step returns, is another thing."""

    def __init__(self, fault=""):
        super().__init__("plant", 50)
        self.fault = fault

    def init(self, parameters, generator, batch):
        return {"x": torch.zeros(batch + (self.fault == "initial state"), 2), "v": torch.zeros(batch, 1)}

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch + (self.fault == "initial output"), 2)

    def step(self, parameters, state, inputs):
        x, v = state["x"], state["v"]
        match self.fault:
            case "batch":
                return state, torch.zeros(len(x) + 1, 2)
            case "entries":
                return state, x[:, :1]
            case "type":
                return state, x.double()
            case "no tensor":
                return state, [0.0, 0.0]
            case "key":
                return {"x": x}, x
            case "state shape":
                return {"x": x, "v": v[:, 0]}, x
            case _:
                return state, x


FAULTS = {
    "initial state": (None, r'initial state "x" has shape \(2, 2\); the first axis must be the batch of 1'),
    "initial output": (None, r"initial output has shape \(2, 2\); the first axis must be the batch of 1"),
    "batch": (0, r"output is \(2, 2\) float32, the initial output \(1, 2\) float32"),
    "entries": (0, r"output is \(1, 1\) float32, the initial output \(1, 2\) float32"),
    "type": (0, r"output is \(1, 2\) float64, the initial output \(1, 2\) float32"),
    "no tensor": (0, "output is no tensor but list"),
    "key": (0, r"state has the keys \['x'\], before the step \['v', 'x'\]"),
    "state shape": (0, r'state "v" is \(1,\) float32, before the step \(1, 1\) float32'),
}


def graph(fault: str = "") -> Graph:
    agent = Supervisor("agent", 50, initial_action=torch.zeros(2))
    return Graph(
        [Faulty(fault), agent], [Connection("plant", "agent"), Connection("agent", "plant", skip=True)]
    )


def drawn(robot: Graph):
    return draw_timing(robot, np.random.default_rng(0), 4, 1)


RUNTIMES = {
    "batched": lambda robot: BatchedRuntime(robot, drawn(robot)),
    "simulated": lambda robot: SimulatedRuntime(robot, drawn(robot)),
    "concurrent": lambda robot: ConcurrentRuntime(robot, drawn(robot)),
    "wall clock": lambda robot: WallClockRuntime(robot, threads=("plant",)),
}


def run(runtime, steps: int, batch: int = 1) -> None:
    state, _ = runtime.reset({}, torch.Generator())
    for _ in range(steps):
        state, _ = runtime.step(state, torch.zeros(batch, 2))


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("kind", RUNTIMES)
def test_what_does_not_match_names_node_step_and_shapes(kind, fault):
    tick, reason = FAULTS[fault]
    runtime = RUNTIMES[kind](graph(fault))
    if kind == "batched":
        where = 'node "plant": ' if tick is None else f'node "plant" at its step {tick}: '
        error: type[Exception] = GraphError
    else:  # the error has come out of a node that runs elsewhere: it stops the graph
        where = (
            'node "plant" before its first tick: ' if tick is None else f'node "plant" at its tick {tick}: '
        )
        where, error = where + "GraphError: ", NodeFailure
    with pytest.raises(error, match=where + reason):
        run(runtime, 3)


@pytest.mark.parametrize("action", [torch.zeros(2), torch.zeros(1, 3), torch.zeros(2, 2), np.zeros((1, 1))])
@pytest.mark.parametrize("kind", RUNTIMES)
def test_an_action_of_another_shape_is_refused_and_can_be_given_again(kind, action):
    runtime = RUNTIMES[kind](graph())
    state, _ = runtime.reset({}, torch.Generator())
    state, _ = runtime.step(state, np.zeros((1, 2), dtype=np.float32))
    shape = str(tuple(action.shape)).replace("(", r"\(").replace(")", r"\)")
    with pytest.raises(ValueError, match=rf'action of "agent" at its step 1 has shape {shape}, .* \(1, 2\)'):
        runtime.step(state, action)
    state, _ = runtime.step(state, torch.zeros(1, 2))
    assert int(state.step[0]) == 2
    if kind != "batched":
        runtime.close()


def test_one_row_for_a_batch_is_no_output_of_the_batch():
    class Row(Faulty):
        def step(self, parameters, state, inputs):
            return state, torch.zeros(1, 2)

    agent = Supervisor("agent", 50, initial_action=torch.zeros(2))
    robot = Graph([Row(), agent], [Connection("plant", "agent")])
    runtime = BatchedRuntime(robot, draw_timing(robot, np.random.default_rng(0), 4, 3))
    with pytest.raises(GraphError, match=r'"plant" at its step 0: output is \(1, 2\) .* \(3, 2\)'):
        runtime.reset({}, torch.Generator())


class Late(Faulty):
    """Fails once it has seen action 1, as a node does that copes with all but one of its inputs."""

    inputs = ("agent",)

    def step(self, parameters, state, inputs):
        if int(inputs["agent"].seq.max()) < 1:
            return state, state["x"]
        match self.fault:
            case "raises":
                raise RuntimeError("the motor is hot")
            case "nothing":
                return None
            case _:
                return state, state["x"][:, :1]


@pytest.mark.parametrize(
    ("fault", "error", "message"),
    [
        ("raises", StepError, "RuntimeError: the motor is hot"),
        ("nothing", StepError, "TypeError: cannot unpack"),
        ("narrower", GraphError, r"output is \(2, 1\) float32, the initial output \(2, 2\) float32"),
    ],
)
def test_a_batch_tells_in_which_node_and_at_which_step_it_failed(fault, error, message):
    agent = Supervisor("agent", 50, initial_action=torch.zeros(2))
    robot = Graph(
        [Late(fault), agent], [Connection("plant", "agent"), Connection("agent", "plant", skip=True)]
    )
    runtime = BatchedRuntime(robot, draw_timing(robot, np.random.default_rng(0), 6, 2))
    with pytest.raises(error, match=f'^node "plant" at its step 2: {message}'):
        run(runtime, 5, batch=2)


def test_an_agent_that_fails_to_look_is_named_with_its_step():
    class Blind(Supervisor):
        def observe(self, parameters, state, inputs, action):
            return state, {"observation": inputs["camera"].data}

    robot = Graph(
        [Faulty(), Blind("agent", 50, initial_action=torch.zeros(2))], [Connection("plant", "agent")]
    )
    for executor in ("eager", "fused"):
        runtime = BatchedRuntime(robot, draw_timing(robot, np.random.default_rng(0), 4, 2), executor=executor)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # that it cannot be compiled
            with pytest.raises(StepError, match=r"^node .agent. at its step 0: KeyError: .camera."):
                runtime.reset({}, torch.Generator())


@pytest.mark.parametrize("place", ["step", "observe"])
@pytest.mark.parametrize(
    ("raised", "error", "message"),
    [
        (GraphError("no such camera"), GraphError, "no such camera"),
        (KeyError("camera"), StepError, "KeyError: 'camera'"),
    ],
)
def test_what_a_node_raises_is_told_alike_wherever_it_raises(place, raised, error, message):
    class Plant(Faulty):
        def step(self, parameters, state, inputs):
            if place == "step":
                raise raised
            return state, state["x"]

    class Agent(Supervisor):
        def observe(self, parameters, state, inputs, action):
            if place == "observe":
                raise raised
            return state, {}

    robot = Graph(
        [Plant(), Agent("agent", 50, initial_action=torch.zeros(2))], [Connection("plant", "agent")]
    )
    runtime = BatchedRuntime(robot, drawn(robot))
    name = {"step": "plant", "observe": "agent"}[place]
    with pytest.raises(error, match=f'^node "{name}" at its step 0: {message}$') as caught:
        runtime.reset({}, torch.Generator())
    assert type(caught.value) is error
    assert caught.value.__cause__ is raised


def another(kind: str) -> Graph:
    """A graph that takes the timing of `graph()` for its own, but for one thing."""
    agent = Supervisor("agent", 50, initial_action=torch.zeros(2))
    plant = Connection("plant", "agent", window=2 if kind == "windows" else 1)
    match kind:
        case "nodes":
            return Graph([agent, Faulty()], [plant, Connection("agent", "plant", skip=True)])
        case "connections":
            return Graph([Faulty(), agent], [plant])
        case _:
            return Graph([Faulty(), agent], [plant, Connection("agent", "plant", skip=True)])


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("nodes", "its nodes plant, agent; of this graph agent, plant"),
        ("connections", "its connections plant->agent, agent->plant; of this graph plant->agent$"),
        ("windows", "its windows 1, 1; of this graph 2, 1"),
    ],
)
def test_the_timing_of_another_graph_is_refused_in_every_runtime(kind, message):
    robot, timing = another(kind), drawn(graph())
    with pytest.raises(GraphError, match=message):
        BatchedRuntime(robot, timing)
    runtime = BatchedRuntime(robot)
    with pytest.raises(GraphError, match=message):
        runtime.reset({}, torch.Generator(), timing=timing)
    with SimulatedRuntime(robot, timing) as simulated, pytest.raises(GraphError, match=message):
        simulated.reset({}, torch.Generator())
    with ConcurrentRuntime(robot, timing) as concurrent, pytest.raises(GraphError, match=message):
        concurrent.reset({}, torch.Generator())


NUMBERS = st.floats(width=32) | st.sampled_from([3e38, -3e38, float("nan"), float("inf")])


@given(
    values=st.lists(NUMBERS, min_size=1, max_size=6), dtype=st.sampled_from([torch.float32, torch.float64])
)
def test_check_finite_refuses_exactly_nan_and_infinity(values, dtype):
    value = torch.tensor([values], dtype=dtype)
    wrong = [i for i, number in enumerate(values) if not math.isfinite(number)]
    if not wrong:
        check_finite("output", value)  # also where the sum of large numbers overflows
        return
    with pytest.raises(NotFiniteError, match=rf"^output entry \[{wrong[0]}\] is -?(nan|inf)") as caught:
        check_finite("output", value)
    assert (f", as are {len(wrong) - 1} more" in str(caught.value)) == (len(wrong) > 1)


@pytest.mark.parametrize("value", [torch.tensor([7]), torch.tensor([True]), torch.tensor([1 + 2j])])
def test_check_finite_takes_numbers_of_any_type(value):
    check_finite("output", value)


def test_check_finite_names_an_output_without_axes():
    with pytest.raises(NotFiniteError, match=r"^output is nan; "):
        check_finite("output", torch.tensor([torch.nan]))
