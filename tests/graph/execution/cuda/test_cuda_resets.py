"""Environments that start anew at any time, with nodes that read the times of their inputs."""

import copy
import pickle

import numpy as np
import pytest
import torch
from fused.test_resets import make_graph
from on_device import DEVICES, assert_same_inputs, assert_same_state, make_runtime

from deepkoco.graph import BatchedRuntime, draw_timing


@pytest.mark.parametrize("device", DEVICES)
def test_environments_on_different_steps_of_different_schedules_agree_with_the_eager_executor(device):
    graph, steps, batch = make_graph(), 10, 13
    timing = draw_timing(graph, np.random.default_rng(0), steps, 20, rows=20)
    runtimes = make_runtime(graph, timing, device), BatchedRuntime(graph, timing)
    draws = np.random.default_rng(5)
    rows = draws.integers(20, size=batch)
    states = [runtime.reset({}, torch.Generator(), rows=rows)[0] for runtime in runtimes]
    for _ in range(2 * steps):
        mask = (draws.random(batch) < 0.1) | (states[1].steps_left <= 0)
        rows = draws.integers(20, size=batch)
        states = [
            runtime.reset({}, torch.Generator(), rows=rows, state=state, mask=mask)[0]
            for runtime, state in zip(runtimes, states, strict=True)
        ]
        action = torch.from_numpy(draws.normal(size=(batch, 2)))
        (found, seen), (eager, expected) = (
            runtime.step(state, action) for runtime, state in zip(runtimes, states, strict=True)
        )
        assert_same_inputs(seen, expected)
        assert_same_state(found, eager)
        states = [found, eager]
    assert len(set(states[1].step.tolist())) > 3


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("fresh_timing", [False, True])
def test_a_part_starts_anew_with_other_parameters_or_in_other_schedules(device, fresh_timing):
    from experiments.rollout_work import make_graph, make_parameters

    graph, batch = make_graph(), 6
    timing = draw_timing(graph, np.random.default_rng(0), 8, batch, rows=batch)
    runtimes = make_runtime(graph, timing, device), BatchedRuntime(graph, timing)
    mask = np.arange(batch) % 3 == 1
    other = make_parameters()
    other["world"]["mass"] = other["world"]["mass"] * 1.5  # a number before and after, not the same for all
    more = {"timing": draw_timing(graph, np.random.default_rng(7), 8, batch, rows=batch)}
    actions = torch.randn(8, batch, 1, generator=torch.Generator().manual_seed(1))
    states = []
    for runtime in runtimes:
        state, _ = runtime.reset(make_parameters(), torch.Generator().manual_seed(0))
        state, _ = runtime.rollout(state, actions[:3], 3)
        state, _ = runtime.reset(
            other,
            torch.Generator().manual_seed(2),
            state=state,
            mask=mask,
            **(more if fresh_timing else {"rows": np.arange(batch)[::-1]}),
        )
        states.append(runtime.rollout(state, actions[3:], 5)[0])
    assert_same_state(*states)
    assert states[0].step.tolist() == np.where(mask, 5, 8).tolist()


@pytest.mark.parametrize("device", DEVICES)
def test_a_copy_of_runtime_and_state_goes_on_bit_for_bit(device):
    graph, batch = make_graph(), 5
    timing = draw_timing(graph, np.random.default_rng(2), 9, batch, rows=batch)
    runtime = make_runtime(graph, timing, device)
    actions = torch.randn(9, batch, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    state, _ = runtime.reset({}, torch.Generator().manual_seed(0))
    state, _ = runtime.rollout(state, actions[:4])
    for other, copied in (copy.deepcopy((runtime, state)), pickle.loads(pickle.dumps((runtime, state)))):
        assert_same_inputs(other.step(copied, actions[4])[1], runtime.step(state, actions[4])[1])
        assert_same_state(other.rollout(copied, actions[4:])[0], runtime.rollout(state, actions[4:])[0])
