"""Blocks are worked on together: what an environment does depends on no other one, to the last bit."""

import numpy as np
import pytest
import torch

from deepkoco.graph import BatchedRuntime, draw_timing
from experiments.benchmarks.rollout_work import make_graph, make_parameters, make_policy

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
STEPS, ROWS, BATCH = 30, 4, 230
GRAPH = make_graph()
TIMING = draw_timing(GRAPH, np.random.default_rng(0), STEPS + 1, ROWS, rows=ROWS)
RNG = np.random.default_rng(1)
SCHEDULES = np.sort(RNG.integers(ROWS, size=BATCH))
START = torch.randn(BATCH, 2, generator=torch.Generator().manual_seed(2))
ACTIONS = torch.randn(STEPS, BATCH, 1, generator=torch.Generator().manual_seed(3))
POLICY = make_policy()


def simulate(chosen, policy: bool, far: bool, threads: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """Observations (STEPS, B, 6) and last states (B, 2) of some of the environments."""
    start = START.clone()
    if far:  # beyond what the fast sine can do, in two blocks
        start[[5, 77], 0] = torch.tensor([9000.0, -3e6])
    runtime = BatchedRuntime(GRAPH, TIMING, executor="fused", threads=threads)
    own = {"world": {"state": start[chosen]}}
    state, _ = runtime.reset(make_parameters(), torch.Generator().manual_seed(0), own, rows=SCHEDULES[chosen])
    with torch.no_grad():
        work = POLICY if policy else ACTIONS[:, chosen]
        state, taken = runtime.rollout(state, work, STEPS, record=["observation"])
    return taken["observation"], state.nodes["world"]["state"]


@pytest.mark.parametrize("policy", [False, True])
@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize(("batch", "threads"), [(5, 1), (16, 1), (17, 1), (64, 2), (100, 1), (201, 2)])
def test_an_environment_does_the_same_in_any_batch_and_on_any_number_of_threads(policy, far, batch, threads):
    chosen = np.random.default_rng(batch).permutation(BATCH)[:batch]
    if far:
        chosen[:2] = 5, 77
    found, expected = simulate(chosen, policy, far, threads), simulate(np.arange(BATCH), policy, far)
    assert torch.equal(found[0], expected[0][:, chosen])
    assert torch.equal(found[1], expected[1][chosen])


def test_large_angles_are_those_of_the_eager_executor():
    chosen = np.arange(60, 90)
    results = []
    for executor in ("fused", "eager"):
        runtime = BatchedRuntime(GRAPH, TIMING, executor=executor)
        own = {"world": {"state": START[chosen] + torch.tensor([2.0**14, 0.0])}}
        state, _ = runtime.reset(
            make_parameters(), torch.Generator().manual_seed(0), own, rows=SCHEDULES[chosen]
        )
        state, _ = runtime.rollout(state, ACTIONS[:5, chosen], 5, record=[])
        results.append(state.nodes["world"]["state"])
    torch.testing.assert_close(results[0][:, 1], results[1][:, 1], rtol=1e-3, atol=1e-3)


class Residual(torch.nn.Module):
    """A policy with sums over its units, sines, and a layer without bias."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.last = torch.nn.Linear(6, 48, bias=False), torch.nn.Linear(48, 1)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        hidden = torch.sin(torch.nn.functional.silu(self.first(observation)))
        return self.last(hidden + hidden.mean(1, keepdim=True))


def test_policies_of_other_kinds_decide_as_in_torch():
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        policies = [
            Residual(),
            torch.nn.Sequential(torch.nn.Linear(6, 33), torch.nn.ELU(), torch.nn.Linear(33, 1)),
        ]
    chosen = np.arange(90)
    for policy in policies:
        results = []
        for executor in ("fused", "eager"):
            runtime = BatchedRuntime(GRAPH, TIMING, executor=executor)
            own = {"world": {"state": START[chosen]}}
            state, _ = runtime.reset(
                make_parameters(), torch.Generator().manual_seed(0), own, rows=SCHEDULES[chosen]
            )
            with torch.no_grad():
                state, _ = runtime.rollout(state, policy, 5, record=[])
            results.append(state.nodes["world"]["state"])
        torch.testing.assert_close(*results, rtol=1e-4, atol=1e-4)


def noisy(parameters, seen):
    return torch.tanh(seen["observation"] @ parameters["gain"])[:, None] + seen["noise"]


@pytest.mark.parametrize("batch", [3, 37, 230])
def test_signals_reach_their_own_environment_in_any_batch(batch):
    chosen = np.random.default_rng(batch).permutation(BATCH)[:batch]
    results = []
    for executor in ("fused", "eager"):
        runtime = BatchedRuntime(GRAPH, TIMING, executor=executor)
        own = {"world": {"state": START[chosen]}}
        state, _ = runtime.reset(
            make_parameters(), torch.Generator().manual_seed(0), own, rows=SCHEDULES[chosen]
        )
        gain, noise = {"gain": torch.linspace(-1.0, 1.0, 6)}, {"noise": ACTIONS[:5, chosen]}
        taken = runtime.rollout(state, noisy, 5, record=["action"], parameters=gain, signals=noise)[1]
        results.append(taken["action"])
    torch.testing.assert_close(*results, rtol=1e-4, atol=1e-4)
