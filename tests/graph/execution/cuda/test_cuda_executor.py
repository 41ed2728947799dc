"""The CUDA executor gives what the eager one gives; its function runs on the CPU, its capture on CUDA."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from on_device import DEVICES, assert_same, assert_same_inputs, assert_same_state, make_runtime, needs_cuda

from deepkoco.graph import BatchedRuntime, HorizonError, draw_timing
from experiments.benchmarks.rollout_work import make_graph, make_parameters, make_policy
from tests.graph.timing_reference import graphs, policy

STEPS = 12


def compare_on_random_graph(graph, batch: int, rows: int, seed: int, device: str) -> None:
    timing = draw_timing(graph, np.random.default_rng(seed), 5, rows, rows=rows)
    chosen = np.random.default_rng(seed).integers(rows, size=batch)
    runtimes = make_runtime(graph, timing, device), BatchedRuntime(graph, timing)
    (found, seen), (eager, expected) = (
        r.reset({}, torch.Generator().manual_seed(seed), rows=chosen) for r in runtimes
    )
    for k in range(5):
        assert_same_inputs(seen, expected)
        action = policy({name: i.data for name, i in expected.items()}, k)
        found, seen = runtimes[0].step(found, action)
        eager, expected = runtimes[1].step(eager, action)
    assert_same_inputs(seen, expected)
    assert_same_state(found, eager)


@settings(max_examples=20, deadline=None)
@given(graph=st.booleans().flatmap(graphs), batch=st.sampled_from([1, 2, 7]), seed=st.integers(0, 99))
def test_random_graphs_run_bitwise_as_in_the_eager_executor(graph, batch, seed):
    compare_on_random_graph(graph, batch, 4, seed, "cpu")


@needs_cuda
@settings(max_examples=100, deadline=None)
@given(graph=st.booleans().flatmap(graphs), seed=st.integers(0, 99))
def test_random_graphs_run_captured_as_in_the_eager_executor(graph, seed):
    compare_on_random_graph(graph, 7, 4, seed, "cuda")


class Pendulums:
    """The pendulum of the benchmark in both executors, five schedules."""

    def __init__(self, device: str, batch: int = 9) -> None:
        self.graph, self.batch = make_graph(), batch
        self.timing = draw_timing(self.graph, np.random.default_rng(0), STEPS, 5, rows=5)
        self.runtimes = make_runtime(self.graph, self.timing, device), BatchedRuntime(self.graph, self.timing)
        self.rows = np.random.default_rng(1).integers(5, size=batch)
        self.actions = torch.randn(STEPS, batch, 1, generator=torch.Generator().manual_seed(0))

    def reset(self, parameters=None, **options):
        options = {"rows": self.rows} | options
        generator = torch.Generator().manual_seed(0)
        return [r.reset(parameters or make_parameters(), generator.manual_seed(0), **options)[0]
                for r in self.runtimes]  # fmt: skip


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("environments", [1, None])
def test_given_actions_are_rolled_out_as_step_by_step(device, environments):
    both = Pendulums(device)
    actions = both.actions[:, :environments]
    states = both.reset()
    (found, recorded), (eager, expected) = (
        r.rollout(s, actions, STEPS) for r, s in zip(both.runtimes, states, strict=True)
    )
    assert_same_state(found, eager)
    assert list(recorded) == list(expected) == ["action", "observation"]
    for name, value in expected.items():
        assert_same(recorded[name], value)
    state = states[0]
    for k in range(STEPS):
        state, _ = both.runtimes[0].step(state, actions[k].expand(9, 1))
        assert torch.equal(state.readings["observation"], recorded["observation"][k])


@pytest.mark.parametrize("device", DEVICES)
def test_a_module_acts_with_the_weights_that_it_has_when_it_is_called(device):
    both = Pendulums(device)
    states, module = both.reset(), make_policy()
    for factor in (1.0, 0.5):
        with torch.no_grad():
            module[0].weight *= factor
        results = [
            r.rollout(s, module, STEPS, record=["action"]) for r, s in zip(both.runtimes, states, strict=True)
        ]
        assert_same(results[0][1]["action"], results[1][1]["action"].detach())
        assert list(results[0][1]) == ["action"]


@pytest.mark.parametrize("device", DEVICES)
def test_a_policy_may_have_parameters_of_its_own(device):
    both = Pendulums(device)
    states = both.reset()

    def damp(parameters, seen):
        return torch.tanh(seen["observation"] @ parameters["gain"])[:, None] * 3

    for gain in (torch.linspace(-1, 1, 6), torch.linspace(2, 0, 6)):
        found, eager = (
            r.rollout(s, damp, STEPS, parameters={"gain": gain})[1]["action"]
            for r, s in zip(both.runtimes, states, strict=True)
        )
        assert_same(found, eager)


@pytest.mark.parametrize("device", DEVICES)
def test_a_policy_is_shown_signals_of_its_step_and_environment(device):
    both = Pendulums(device)
    states = both.reset()

    def follow(parameters, seen):
        return seen["noise"] + 2.0 * (seen["target"] - seen["observation"][:, :1])

    for seed in (0, 1):
        noise = torch.randn(STEPS, 9, 1, generator=torch.Generator().manual_seed(seed))
        signals = {"noise": noise, "target": torch.linspace(-1, 1, STEPS)[:, None, None]}
        found, eager = (
            r.rollout(s, follow, STEPS, signals=signals)[1]["action"]
            for r, s in zip(both.runtimes, states, strict=True)
        )
        assert_same(found, eager)


@pytest.mark.parametrize("device", DEVICES)
def test_parameters_of_each_environment_act_in_it_alone(device):
    both = Pendulums(device)
    parameters = make_parameters()
    parameters["world"]["mass"] = parameters["world"]["mass"] * torch.linspace(0.5, 1.5, 9)
    states = both.reset(parameters)
    found, eager = (r.rollout(s, both.actions, STEPS)[0] for r, s in zip(both.runtimes, states, strict=True))
    assert_same_state(found, eager)


@pytest.mark.parametrize("device", DEVICES)
def test_states_are_not_changed_in_place_and_can_be_taken_up_again(device):
    both = Pendulums(device)
    runtime, state, action = both.runtimes[0], both.reset()[0], both.actions[0]
    kept, _ = runtime.step(state, action)
    before = {name: own[0].clone() for name, own in kept.outputs.items()}
    once, _ = runtime.step(kept, action)
    runtime.step(runtime.step(once, action * 5)[0], action)
    runtime.rollout(kept, both.actions[:3], 3)
    again, _ = runtime.step(kept, action)
    assert torch.equal(once.readings["observation"], again.readings["observation"])
    assert all(torch.equal(kept.outputs[name][0], value) for name, value in before.items())


@pytest.mark.parametrize("device", DEVICES)
def test_beyond_the_horizon_nothing_runs(device):
    both = Pendulums(device)
    runtime, state = both.runtimes[0], both.reset()[0]
    with pytest.raises(HorizonError, match=f"environment 0 has {STEPS} left for {STEPS + 1} steps"):
        runtime.rollout(state, torch.zeros(STEPS + 1, 1, 1), STEPS + 1)
    state, _ = runtime.rollout(state, both.actions, STEPS)
    with pytest.raises(HorizonError, match=f"environment 0 has taken all {STEPS} supervisor steps"):
        runtime.step(state, both.actions[0])


def test_a_recording_runs_step_by_step_and_goes_on_as_one_function():
    both = Pendulums("cpu")
    trace: list = []
    generator = torch.Generator().manual_seed(0)
    found, _ = both.runtimes[0].reset(make_parameters(), generator, rows=both.rows, trace=trace)
    found, _ = both.runtimes[0].step(found, both.actions[0], trace)
    found, _ = both.runtimes[0].step(found, both.actions[1])
    eager = both.reset()[1]
    for k in range(2):
        eager, _ = both.runtimes[1].step(eager, both.actions[k])
    assert_same_state(found, eager)
    assert {position for position, _, _ in trace} == set(range(len(both.graph.nodes)))


def test_an_environment_needs_less_than_two_kilobytes():
    state = Pendulums("cpu", batch=256).reset()[0]
    assert state.nbytes / 256 < 300


@needs_cuda
def test_the_capture_gives_bitwise_what_its_operations_give_one_by_one():
    both = Pendulums("cuda")
    captured = both.runtimes[0]
    one_by_one = BatchedRuntime(both.graph, both.timing, executor="cuda")
    one_by_one._executor.capture = False
    for acting in (both.actions, make_policy()):
        results = []
        for runtime in (captured, one_by_one):
            generator = torch.Generator().manual_seed(0)
            state, _ = runtime.reset(make_parameters(), generator, rows=both.rows)
            results.append(runtime.rollout(state, acting, STEPS)[1])
        for name, value in results[0].items():
            assert torch.equal(value, results[1][name])
