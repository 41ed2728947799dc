"""Outputs of several tensors: dicts for who sends and who receives, in every executor, runtime and record."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from dict_nodes import Arm, Camera, act, dict_graph
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.graph import (
    BatchedRuntime,
    ConcurrentRuntime,
    Connection,
    EpisodeFileError,
    Graph,
    GraphError,
    Node,
    SimulatedRuntime,
    Supervisor,
    WallClockRuntime,
    draw_timing,
    read_episodes,
    record_episodes,
    replay_episode,
    write_episodes,
)
from deepkoco.graph.episodes.export import episode_table
from deepkoco.graph.execution.cuda import TensorExecutor
from deepkoco.graph.model.parts import Parts, PartsError

STEPS = 12
TYPES = [torch.bool, torch.uint8, torch.int16, torch.int32, torch.float32, torch.float64]


def seed(number: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(number)


def one_timing():
    return draw_timing(dict_graph(), np.random.default_rng(0), STEPS, 1)


@given(
    kinds=st.lists(
        st.tuples(st.sampled_from(TYPES), st.lists(st.integers(0, 3), max_size=3)), min_size=1, max_size=5
    ),
    batch=st.integers(1, 3),
    window=st.integers(1, 3),
)
def test_parts_come_back_as_they_were(kinds, batch, window):
    parts = Parts.of({f"part {k}": (tuple(shape), dtype) for k, (dtype, shape) in enumerate(kinds)})
    messages = []
    for number in range(window):
        output = {}
        for name, shape, dtype in parts.entries:
            whole = torch.randint(-(2**31), 2**31 - 1, (batch, *shape), generator=seed(number))
            real = torch.randn(batch, *shape, generator=seed(number), dtype=torch.float64)
            output[name] = (real if dtype.is_floating_point else whole).to(dtype)
        messages.append(output)
    packed = torch.stack([parts.pack(output) for output in messages], 1)
    for found in (
        parts.split(packed),
        {k: torch.from_numpy(v) for k, v in parts.split_array(packed.numpy()).items()},
    ):
        for name, shape, dtype in parts.entries:
            assert found[name].dtype == dtype
            assert found[name].shape == (batch, window, *shape)
            assert torch.equal(found[name], torch.stack([output[name] for output in messages], 1))


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"a": ((), torch.int64), "b": ((), torch.float32)}, '"a" torch.int64 beside "b" torch.float32'),
        ({"a": ((), torch.complex64)}, "complex"),
        ({"a": (2, torch.float32)}, "no shape and type"),
        ({"a": ((2,), float)}, "no shape and type"),
        ({}, "no parts"),
    ],
)
def test_parts_that_cannot_be_held_together_are_refused(declared, message):
    with pytest.raises(PartsError, match=message):
        Parts.of(declared)


def batched():
    runtime = BatchedRuntime(dict_graph(), one_timing())
    episodes, state = record_episodes(runtime, act, {}, seed())
    return episodes[0], state


def assert_same_outputs(found, expected) -> None:
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name].dtype == values.dtype
        assert found[name].tobytes() == values.tobytes(), name


def test_receivers_see_dicts_with_the_window():
    runtime = BatchedRuntime(dict_graph(), draw_timing(dict_graph(), np.random.default_rng(0), 5, 3, rows=3))
    state, seen = runtime.reset({}, seed())
    for _ in range(4):
        state, seen = runtime.step(state, act(seen))
    camera, arm = seen["camera"].data, seen["arm"].data
    assert list(camera) == ["picture", "stamp"]
    assert camera["picture"].shape == (3, 2, 4, 3)
    assert (camera["picture"].dtype, camera["stamp"].dtype) == (torch.float32, torch.float64)
    assert (arm["contact"].dtype, arm["ticks"].dtype) == (torch.bool, torch.int32)
    assert torch.equal(arm["contact"], arm["angles"][..., 0] > arm["angles"][..., 1])
    # The message that has the number k is that of step k, and a stamp is the start of its step.
    assert torch.equal(arm["ticks"], seen["arm"].seq.to(torch.int32) + 1)
    assert torch.equal(camera["stamp"], seen["camera"].t_sent)


def fused(graph, timing):
    return BatchedRuntime(graph, timing, executor="fused")


def tensors(graph, timing):
    runtime = BatchedRuntime(graph, timing)
    runtime._executor = TensorExecutor(graph, torch.device("cpu"), capture=False)
    return runtime


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("batch", [1, 37])
@pytest.mark.parametrize("make", [fused, tensors])
def test_other_executors_agree_with_the_eager_one(make, batch):
    graph = dict_graph()
    timing = draw_timing(graph, np.random.default_rng(0), STEPS, batch, rows=batch)
    actions = torch.randn(STEPS, batch, 2, generator=seed(5), dtype=torch.float64)
    results = []
    for runtime in (make(graph, timing), BatchedRuntime(graph, timing)):
        state, _ = runtime.reset({}, seed())
        state, _ = runtime.rollout(state, actions[:5])
        state, _ = runtime.reset({}, seed(2), state=state, mask=np.arange(batch) % 3 == 0)
        results.append((*runtime.rollout(state, actions[5:-1]), runtime))
    (found, taken, runtime), (expected, wanted, eager) = results
    for name, values in wanted.items():
        torch.testing.assert_close(taken[name], values, rtol=1e-6, atol=1e-6)
    seen, truth = (r.step(s, actions[-1])[1] for r, s in ((runtime, found), (eager, expected)))
    for name in ("arm", "camera"):
        for part, value in truth[name].data.items():
            torch.testing.assert_close(seen[name].data[part], value, rtol=1e-6, atol=1e-6)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_policy_on_parts_is_compiled():
    graph = dict_graph()
    agent = Supervisor("agent", 20, initial_action=torch.zeros(2, dtype=torch.float64))
    graph = Graph([*graph.nodes[:2], agent], graph.connections)
    timing = draw_timing(graph, np.random.default_rng(0), STEPS, 9, rows=9)
    taken = []
    for executor in ("fused", "eager"):
        runtime = BatchedRuntime(graph, timing, executor=executor)
        state, _ = runtime.reset({}, seed())
        taken.append(runtime.rollout(state, lambda parameters, seen: act(seen), STEPS)[1]["action"])
    torch.testing.assert_close(*taken, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "make",
    [
        SimulatedRuntime,
        ConcurrentRuntime,
        partial(ConcurrentRuntime, processes={"arm": 1, "camera": 2}),
    ],
    ids=["simulated", "threads", "processes"],
)
def test_other_runtimes_are_the_batched_one_bit_for_bit(make):
    with make(dict_graph(), one_timing()) as runtime:
        runtime.reset({}, seed())
        runtime.run(act, STEPS)
        found = runtime.finish().outputs
    assert_same_outputs(found, batched()[0].outputs)


def test_a_run_on_the_clock_is_kept_in_a_file_and_replays(tmp_path):
    file = tmp_path / "run.mcap"
    with WallClockRuntime(dict_graph(), threads=("arm",), record=file) as runtime:
        runtime.reset({}, seed(3))
        runtime.run(act, 6)
        episode = runtime.finish()
    run = read_episodes(file)
    assert_same_outputs(run.episodes[0].outputs, episode.outputs)
    again, _ = replay_episode(dict_graph(), run.episodes[0], {}, seed(3))
    assert_same_outputs(again.outputs, episode.outputs)


def test_a_recording_knows_the_parts(tmp_path):
    episode, _ = batched()
    write_episodes(tmp_path / "run.mcap", dict_graph(), [episode])
    run = read_episodes(tmp_path / "run.mcap")
    camera = run.graph.parts["camera"].split_array(run.episodes[0].outputs["camera"])
    assert camera["picture"].dtype == np.float32
    assert camera["picture"].shape[1:] == (4, 3)
    assert np.array_equal(camera["stamp"], episode.t_start["camera"][: len(camera["stamp"])])
    table = episode_table(run.graph, run.episodes[0])
    assert table["camera/output/stamp/0"].dropna().to_numpy().tolist() == camera["stamp"].tolist()
    assert "arm/output/wrench/5" in table


def test_a_recording_whose_outputs_do_not_hold_the_parts_is_refused(tmp_path):
    episode, _ = batched()
    cut = replace(episode, outputs=episode.outputs | {"camera": episode.outputs["camera"][:, :-1]})
    write_episodes(tmp_path / "run.mcap", dict_graph(), [cut])
    with pytest.raises(EpisodeFileError, match=r'node "camera": its outputs have the shape .* stamp need'):
        read_episodes(tmp_path / "run.mcap")


def test_gradients_go_through_parts():
    graph = dict_graph()
    runtime = BatchedRuntime(graph, one_timing())
    actions = torch.zeros(STEPS, 1, 2, dtype=torch.float64, requires_grad=True)
    state, _ = runtime.reset({}, seed())
    state, taken = runtime.rollout(state, actions)
    (gradient,) = torch.autograd.grad(taken["light"].sum() + taken["observation"].sum(), actions)
    assert gradient[:3].abs().min() > 0


class Undeclared(Arm):
    outputs = None


class Renamed(Arm):
    def seen(self, state):
        return super().seen(state) | {"angle": state["x"]}


class Reshaped(Arm):
    def seen(self, state):
        return super().seen(state) | {"angles": state["x"][:, :1]}


class Bare(Camera):
    def step(self, parameters, state, inputs):
        return state, torch.zeros(len(inputs["arm"].seq), 13)


def first_step(node: Node) -> None:
    graph = dict_graph()
    nodes = [node if n.name == node.name else n for n in graph.nodes]
    runtime = BatchedRuntime(Graph(nodes, graph.connections), one_timing())
    runtime.reset({}, seed())


@pytest.mark.parametrize(
    ("node", "message"),
    [
        (Undeclared("arm", 50), r'outputs = {"wrench": \(\(2, 3\), torch.float32\), "angles"'),
        (Renamed("arm", 50), "declared are the parts"),
        (Reshaped("arm", 50), r'part "angles" is torch.float64 \(1, 1\), declared torch.float64 \(B, 2\)'),
        (Bare("camera", 30), "the output is Tensor, declared are the parts"),
    ],
)
def test_outputs_that_are_not_as_declared_are_refused(node, message):
    with pytest.raises(GraphError, match=message):
        first_step(node)


def test_the_supervisor_has_no_parts():
    agent = Supervisor("agent", 20, initial_action=torch.zeros(2))
    agent.outputs = {"action": ((2,), torch.float32)}
    with pytest.raises(GraphError, match="its output is the action"):
        Graph([Arm("arm", 50), agent], [Connection("agent", "arm", skip=True)])
