"""The fused executor gives what the eager one gives."""

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepkoco.graph import (
    BatchedRuntime,
    Connection,
    Graph,
    GraphError,
    HorizonError,
    Node,
    RuntimeState,
    Supervisor,
    draw_timing,
)
from experiments.benchmarks.rollout_work import Relay, make_graph, make_parameters, make_policy
from tests.graph.timing_reference import graphs, policy

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
STEPS = 12


def seed() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def assert_same_state(fused: RuntimeState, eager: RuntimeState, tolerance: float) -> None:
    np.testing.assert_array_equal(fused.row, eager.row)
    np.testing.assert_array_equal(fused.step, eager.step)
    np.testing.assert_array_equal(fused.time, eager.time)
    for name, values in eager.nodes.items():
        assert fused.nodes[name].keys() == values.keys()
        for key, value in values.items():
            torch.testing.assert_close(fused.nodes[name][key], value, rtol=tolerance, atol=tolerance)
    assert fused.readings.keys() == eager.readings.keys()
    for key, value in eager.readings.items():
        torch.testing.assert_close(fused.readings[key], value, rtol=tolerance, atol=tolerance)


def assert_same_inputs(fused, eager, tolerance: float) -> None:
    assert list(fused) == list(eager)
    for name, expected in eager.items():
        for part, value in zip(fused[name], expected, strict=True):
            torch.testing.assert_close(part, value, rtol=tolerance, atol=tolerance)


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(graph=graphs(), batch=st.sampled_from([2, 11]), seed=st.integers(0, 99))
def test_random_graphs_run_as_in_the_eager_executor(graph, batch, seed):
    timing = draw_timing(graph, np.random.default_rng(seed), 5, batch, rows=batch)
    runtimes = [BatchedRuntime(graph, timing, executor=name) for name in ("fused", "eager")]
    (fused, seen), (eager, expected) = (r.reset({}, torch.Generator().manual_seed(seed)) for r in runtimes)
    for k in range(5):
        assert_same_inputs(seen, expected, 1e-13)
        action = policy({name: i.data for name, i in expected.items()}, k)
        fused, seen = runtimes[0].step(fused, action)
        eager, expected = runtimes[1].step(eager, action)
    assert_same_inputs(seen, expected, 1e-13)
    assert_same_state(fused, eager, 1e-13)


class Pendulums:
    """The pendulum of the benchmark in both executors."""

    def __init__(self, rows: int = 5, batch: int | None = None, seed: int = 0, **options) -> None:
        self.graph = make_graph()
        self.timing = draw_timing(self.graph, np.random.default_rng(seed), STEPS, rows, rows=rows)
        self.fused = BatchedRuntime(self.graph, self.timing, executor="fused", **options)
        self.eager = BatchedRuntime(self.graph, self.timing)
        self.rows = np.random.default_rng(1).integers(rows, size=batch or rows)[::-1].copy()

    def reset(self, parameters=None, **options):
        options = {"rows": self.rows} | options
        return [
            runtime.reset(parameters or make_parameters(), seed(), **options)[0]
            for runtime in (self.fused, self.eager)
        ]

    def step(self, states, action):
        return [r.step(s, action)[0] for r, s in zip((self.fused, self.eager), states, strict=True)]


def actions(steps: int, batch: int) -> torch.Tensor:
    return torch.randn(steps, batch, 1, generator=seed())


@pytest.mark.parametrize("batch", [1, 3, 37])
def test_single_precision_readings_and_given_actions_agree(batch):
    both = Pendulums(batch=batch)
    assert batch == 1 or any(np.diff(both.rows) < 0)  # lanes are in another order than environments
    states = both.reset()
    given_actions = actions(STEPS, batch)
    fused, recorded = both.fused.rollout(states[0], given_actions, STEPS)
    eager, expected = both.eager.rollout(states[1], given_actions, STEPS)
    assert_same_state(fused, eager, 2e-5)
    assert set(recorded) == {"action", "observation"}
    assert recorded["observation"].shape == (STEPS, batch, 6)
    for name, value in expected.items():
        torch.testing.assert_close(recorded[name], value, rtol=2e-5, atol=2e-5)
    for k in range(STEPS):
        states = both.step(states, given_actions[k])
        assert torch.equal(states[0].readings["observation"], recorded["observation"][k])


@pytest.mark.parametrize("threads", [1, 2])
def test_a_policy_runs_inside_the_kernel(threads):
    both = Pendulums(batch=70, threads=threads)
    states = both.reset()
    module = make_policy()
    with torch.no_grad():
        eager, expected = both.eager.rollout(states[1], module, STEPS)
    fused, recorded = both.fused.rollout(states[0], module, STEPS, record=["action"])
    assert_same_state(fused, eager, 5e-5)
    assert list(recorded) == ["action"]
    torch.testing.assert_close(recorded["action"], expected["action"], rtol=5e-5, atol=5e-5)
    with torch.no_grad():
        module[0].weight *= 0.5
        _, expected = both.eager.rollout(states[1], module, 3)
    _, recorded = both.fused.rollout(states[0], module, 3)
    torch.testing.assert_close(recorded["action"], expected["action"], rtol=5e-5, atol=5e-5)


def test_a_policy_may_have_parameters_of_its_own():
    both = Pendulums(batch=9)
    states = both.reset()

    def damp(parameters, seen):
        return torch.tanh(seen["observation"] @ parameters["gain"])[:, None] * 3

    gain = {"gain": torch.linspace(-1, 1, 6)}
    results = [
        runtime.rollout(state, damp, STEPS, parameters=gain)[1]["action"]
        for runtime, state in zip((both.fused, both.eager), states, strict=True)
    ]
    torch.testing.assert_close(*results, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_policy_is_shown_signals_of_its_step_and_environment(threads):
    both = Pendulums(batch=37, threads=threads)
    states = both.reset()

    def follow(parameters, seen):
        return seen["noise"] + parameters["gain"] * (seen["target"][:, None] - seen["observation"][:, :1])

    signals = {"noise": actions(STEPS, 37), "target": torch.linspace(-1, 1, STEPS)[:, None]}
    results = [
        runtime.rollout(state, follow, STEPS, parameters={"gain": torch.tensor(2.0)}, signals=signals)[1]
        for runtime, state in zip((both.fused, both.eager), states, strict=True)
    ]
    torch.testing.assert_close(results[0]["action"], results[1]["action"], rtol=5e-5, atol=5e-5)
    before = torch.stack([states[1].readings["observation"], *results[1]["observation"][:-1]])
    by_hand = signals["noise"] + 2.0 * (signals["target"][..., None] - before[..., :1])
    torch.testing.assert_close(results[1]["action"], by_hand, rtol=2e-5, atol=2e-5)


def test_signals_that_fit_no_step_or_environment_are_refused():
    both = Pendulums(batch=9)
    state = both.reset()[0]
    for signals, said in (
        ({"noise": actions(4, 9)}, "for 5 steps of 9 environments"),
        ({"noise": actions(5, 8)}, "expected .steps, B or 1, ...."),
        ({"observation": actions(5, 9)}, "has the name of a reading"),
    ):
        with pytest.raises(ValueError, match=said):
            both.fused.rollout(state, make_policy(), 5, signals=signals)


def test_a_policy_that_holds_its_weights_itself_never_acts_with_old_ones():
    both = Pendulums(batch=9)
    state, module = both.reset()[0], make_policy()

    def act(parameters, seen):
        return module(seen["observation"])

    with pytest.warns(RuntimeWarning, match="policy: .* reads a tensor that requires gradients"):
        before = both.fused.rollout(state, act, 1, record=["action"])[1]["action"]
    with torch.no_grad():
        module[-1].weight.zero_()
        module[-1].bias.fill_(2.0)
    after = both.fused.rollout(state, act, 1, record=["action"])[1]["action"]
    assert not torch.equal(before, after)
    assert torch.equal(after, torch.full_like(after, 2.0))


def test_a_policy_in_another_mode_is_another_policy():
    both = Pendulums(batch=9)
    state = both.reset()[0]

    class Explorer(torch.nn.Module):
        def forward(self, observation):
            return observation[:, :1] * 0 + (3.0 if self.training else 1.0)

    module = Explorer()
    for training, expected in ((True, 3.0), (False, 1.0)):
        action = both.fused.rollout(state, module.train(training), 1, record=["action"])[1]["action"]
        assert torch.equal(action, torch.full_like(action, expected))


def test_a_policy_that_cannot_be_compiled_runs_between_steps():
    both = Pendulums(batch=9)
    states = both.reset()

    def sorts(parameters, seen):
        return seen["observation"].sort(1).values[:, :1]

    expected = both.eager.rollout(states[1], sorts, 3)[1]["action"]
    with pytest.warns(
        RuntimeWarning, match=r"policy: aten.sort.* no mapping; this policy runs between steps"
    ):
        result = both.fused.rollout(states[0], sorts, 3)[1]["action"]
    torch.testing.assert_close(result, expected, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("timing", [None, 7])
def test_some_environments_start_anew_while_others_go_on(timing):
    both = Pendulums(batch=21)
    states = both.reset()
    given_actions = actions(2 * STEPS, 21)
    for k in range(5):
        states = both.step(states, given_actions[k])
    mask = np.arange(21) % 3 == 1
    rows = np.random.default_rng(4).integers(5, size=21)
    more = {"rows": rows}
    if timing is not None:
        fresh = draw_timing(both.graph, np.random.default_rng(timing), STEPS, 21, rows=21)
        more = {"timing": fresh, "rows": np.arange(21)}
    world = {k: v * torch.linspace(0.9, 1.1, 21) for k, v in make_parameters()["world"].items()}
    results = []
    for runtime, state in zip((both.fused, both.eager), states, strict=True):
        before = {n: {k: v.clone() for k, v in values.items()} for n, values in state.nodes.items()}
        results.append(runtime.reset({"world": world}, seed(), state=state, mask=mask, **more)[0])
        for name, values in before.items():
            assert all(torch.equal(state.nodes[name][key], value) for key, value in values.items())
    assert_same_state(*results, 2e-5)
    if timing is None:
        np.testing.assert_array_equal(results[0].row, np.where(mask, rows, both.rows))
        assert results[0].schedule is states[0].schedule
    for k in range(5, STEPS):
        results = both.step(results, given_actions[k])
    assert_same_state(*results, 2e-5)


def test_parameters_of_each_environment_act_in_it_alone():
    both = Pendulums(rows=1, batch=20)
    parameters = make_parameters()
    parameters["world"]["mass"] = parameters["world"]["mass"] * torch.linspace(0.5, 1.5, 20)
    fused, eager = both.reset(parameters)
    given_actions = actions(STEPS, 1)
    fused, _ = both.fused.rollout(fused, given_actions, STEPS)
    eager, _ = both.eager.rollout(eager, given_actions, STEPS)
    assert_same_state(fused, eager, 2e-5)


def test_states_are_not_changed_in_place():
    both = Pendulums(batch=6)
    (kept, _), action = both.reset(), actions(1, 6)[0]
    once = both.fused.step(kept, action)[0].readings["observation"]
    both.fused.step(both.fused.step(kept, action * 5)[0], action)
    both.fused.rollout(kept, action.expand(3, 6, 1), 3)
    assert torch.equal(both.fused.step(kept, action)[0].readings["observation"], once)
    reading = kept.readings["observation"]
    reading += 1
    assert not torch.equal(kept.readings["observation"], reading)


def test_beyond_the_horizon_nothing_runs():
    both = Pendulums(batch=6)
    state = both.reset()[0]
    for runtime, start in zip((both.fused, both.eager), both.reset(), strict=True):
        with pytest.raises(HorizonError, match=f"environment 0 has {STEPS} left for {STEPS + 1} steps"):
            runtime.rollout(start, actions(STEPS + 1, 6), STEPS + 1)
    state, _ = both.fused.rollout(state, actions(STEPS, 6), STEPS)
    with pytest.raises(HorizonError, match=f"environment 0 has taken all {STEPS} supervisor steps"):
        both.fused.step(state, torch.zeros(6, 1))


def test_a_recording_runs_eagerly_and_goes_on_fused():
    both = Pendulums(batch=6)
    trace: list = []
    state, _ = both.fused.reset(make_parameters(), seed(), rows=both.rows, trace=trace)
    state, _ = both.fused.step(state, actions(1, 6)[0], trace)
    expected = both.step(both.reset(), actions(1, 6)[0])[1]
    assert_same_state(state, expected, 2e-5)
    assert {position for position, _, _ in trace} == set(range(len(both.graph.nodes)))


def test_wrong_actions_names_and_rows_are_refused():
    both = Pendulums(batch=6)
    state = both.reset()[0]
    with pytest.raises(
        ValueError, match=r'action of "agent" has shape \(5, 1\), the initial action \(6, 1\)'
    ):
        both.fused.step(state, torch.zeros(5, 1))
    with pytest.raises(ValueError, match='"speed" is no reading; known: action, observation'):
        both.fused.rollout(state, actions(2, 6), 2, record=["speed"])
    with pytest.raises(ValueError, match=r"actions \(2, 6, 1\) for 3 steps"):
        both.fused.rollout(state, actions(2, 6), 3)
    with pytest.raises(ValueError, match="a rollout of 0 steps"):
        both.fused.rollout(state, actions(2, 6), 0)
    with pytest.raises(ValueError, match=r'"world.mass" \(5,\) is neither a number nor one for each of 6'):
        both.reset({"world": make_parameters()["world"] | {"mass": torch.ones(5)}})
    with pytest.raises(ValueError, match="no rows"):
        both.fused.reset(make_parameters(), seed(), rows=np.zeros(0, int))
    with pytest.raises(ValueError, match="there are schedules 0 to 4"):
        both.fused.reset(make_parameters(), seed(), rows=np.array([0, 5]))
    with pytest.raises(ValueError, match='executor "fast" is none of eager, fused'):
        BatchedRuntime(both.graph, both.timing, executor="fast")
    with pytest.raises(ValueError, match='"fused" runs on the CPU, not on meta'):
        BatchedRuntime(both.graph, both.timing, "meta", executor="fused")


def test_a_node_that_is_not_pure_is_refused():
    class Engine(Relay):
        pure = False

    graph = make_graph()
    timing = draw_timing(graph, np.random.default_rng(0), 2, 1)
    graph.nodes[1].__class__ = Engine
    with pytest.raises(GraphError, match='node "sensor" is not pure'):
        BatchedRuntime(graph, timing, executor="fused").reset(make_parameters(), seed())
    with pytest.raises(GraphError, match="not in 2"):
        BatchedRuntime(graph, timing).reset(make_parameters(), seed(), rows=np.zeros(2, int))


def test_an_environment_needs_less_than_two_kilobytes():
    both = Pendulums(batch=256)
    state = both.reset()[0]
    assert state.nbytes / 256 < 300


class SinglePrecisionLooker(Node):
    """Integrates its gain; it looks at values, which no kernel can do, where the gain is of single precision."""

    def init(self, parameters, generator, batch):
        return {"sum": torch.zeros(batch, dtype=torch.float64)}

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1, dtype=torch.float64)

    def step(self, parameters, state, inputs):
        gain = parameters["gain"]
        if gain.dtype == torch.float32 and bool((gain < 0).any()):
            raise ValueError("negative gain")
        total = state["sum"] + gain.double()
        return {"sum": total}, total[:, None]


def test_states_of_before_the_eager_executor_took_over_go_on():
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1, dtype=torch.float64))
    graph = Graph([SinglePrecisionLooker("plant", 10), agent], [Connection("plant", "agent")])
    timing = draw_timing(graph, np.random.default_rng(0), 4, 2)
    runtime = BatchedRuntime(graph, timing, executor="fused")
    compiled, _ = runtime.reset(
        {"plant": {"gain": torch.tensor(2.0, dtype=torch.float64)}}, torch.Generator()
    )
    assert runtime.executor == "fused"
    with pytest.warns(RuntimeWarning, match="runs with the eager executor"):
        runtime.reset({"plant": {"gain": torch.tensor(3.0)}}, torch.Generator())
    assert runtime.executor == "eager"
    before = compiled.nodes["plant"]["sum"]
    after, _ = runtime.step(compiled, torch.zeros(2, 1, dtype=torch.float64))
    assert torch.equal(after.nodes["plant"]["sum"], before + 2.0)
