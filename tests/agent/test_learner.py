"""One gradient step: the moving average, and the same step on a GPU."""

import copy

import pytest
import torch

from deepkoco.agent.captured_step import CapturedStep
from deepkoco.agent.config import TrainingConfig, TrainingConfigError
from deepkoco.agent.learner import Learner
from deepkoco.koopman import ModelConfig
from deepkoco.koopman.losses import ChunkBatch


def make_learner(**changes) -> Learner:
    torch.manual_seed(3)
    return Learner(3, 1, TrainingConfig(model=ModelConfig(2, 0.05, (8, 8), (8,)), horizon=4, **changes))


def make_batch() -> ChunkBatch:
    generator = torch.Generator().manual_seed(1)
    observations, actions = (torch.randn(2, 9, n, generator=generator) for n in (3, 1))
    return ChunkBatch(observations, actions, torch.rand(2, 9, generator=generator), torch.ones(2, 5))


def test_the_average_moves_towards_the_weights_by_one_minus_its_decay():
    learner, batch = make_learner(averaging=0.75), make_batch()
    weight = learner.model.encoder.network.linears[0].weight
    average = weight.detach().clone()
    for _ in range(3):
        learner.update(batch)
        average += 0.25 * (weight.detach() - average)
    torch.testing.assert_close(learner.averaged.encoder.network.linears[0].weight, average)


def test_without_averaging_the_last_weights_act():
    learner = make_learner(averaging=0.0)
    learner.update(make_batch())
    for own, followed in zip(learner.averaged.parameters(), learner.model.parameters(), strict=True):
        assert torch.equal(own, followed)


def test_a_restored_learner_goes_on_bit_for_bit():
    one, batch = make_learner(), make_batch()
    one.update(batch)
    other = make_learner()
    other.load_state_dict(copy.deepcopy(one.state_dict()))
    first, second = one.update(batch), other.update(batch)
    assert first.total == second.total
    for own, theirs in zip(one.averaged.parameters(), other.averaged.parameters(), strict=True):
        assert torch.equal(own, theirs)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_named_before_work_starts():
    with pytest.raises(TrainingConfigError, match="no GPU"):
        TrainingConfig(device="cuda").check()


needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")


@needs_gpu
@pytest.mark.parametrize("rollout", ["frozen", "updated"])
def test_a_gpu_learns_what_the_processor_learns(rollout):
    decoder = (6,) if rollout == "updated" else ()
    model = ModelConfig(2, 0.05, (8, 8), (8,), decoder_hidden=decoder)
    learners = []
    for device in ("cpu", "cuda"):
        torch.manual_seed(3)
        config = TrainingConfig(model=model, horizon=4, rollout=rollout, device=device)
        learners.append(Learner(3, 1, config))
    losses = [[learner.update(make_batch()).total.item() for _ in range(20)] for learner in learners]
    assert losses[0] == pytest.approx(losses[1], rel=1e-3)
    for one, other in zip(learners[0].averaged.parameters(), learners[1].averaged.parameters(), strict=True):
        torch.testing.assert_close(one, other.cpu(), rtol=1e-3, atol=1e-4)


@needs_gpu
@pytest.mark.parametrize("changes", [{}, {"input_shrinkage": 0.5, "largest_gradient": 1.0}])
def test_captured_steps_are_those_that_run_kernel_by_kernel(changes):
    one, other = (make_learner(device="cuda", **changes) for _ in range(2))
    other._captured._refused = True
    for step in range(10):
        rate = 1.0 / (1 + step)
        assert one.update(make_batch(), rate).total.item() == other.update(make_batch(), rate).total.item()
    assert one._captured._graphs
    for own, theirs in zip(one.averaged.parameters(), other.averaged.parameters(), strict=True):
        assert torch.equal(own, theirs)


@needs_gpu
def test_a_restored_learner_goes_on_where_steps_are_captured():
    one, batch = make_learner(device="cuda"), make_batch()
    for _ in range(6):
        one.update(batch)
    kept = copy.deepcopy(one.state_dict())
    expected = [one.update(batch).total.item() for _ in range(6)]
    other = make_learner(device="cuda")
    for learner in (one, other):
        learner.load_state_dict(copy.deepcopy(kept))
        assert [learner.update(batch).total.item() for _ in range(6)] == expected
    processor = make_learner()
    processor.load_state_dict(copy.deepcopy(kept))
    assert processor.update(batch).total.item() == pytest.approx(expected[0], rel=1e-3)


@needs_gpu
def test_a_step_that_reads_on_the_host_runs_kernel_by_kernel():
    def step(parts, key):
        return parts[0] * parts[0].sum().item()

    steps = CapturedStep(step, "cuda")
    values = [steps([torch.full((2,), float(k))], None).tolist() for k in range(3)]
    with pytest.warns(UserWarning, match="cannot be captured"):
        values.append(steps([torch.full((2,), 3.0)], None).tolist())
    values.append(steps([torch.full((2,), 4.0)], None).tolist())
    assert values == [[2.0 * k * k] * 2 for k in range(5)]
