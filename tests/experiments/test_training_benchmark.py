"""The training benchmark compares the same work, and predicts the updates that a run makes."""

import json

import pytest
import torch

from deepkoco.agent.buffer import Episode, EpisodeBuffer
from deepkoco.koopman import KoopmanModel, ModelConfig, chunk_losses
from deepkoco.koopman.losses import ChunkBatch
from experiments.benchmarks.training_benchmark import main, read_settings, separate_windows, updates_of_a_run


def draw(observations: torch.Tensor, history: int) -> ChunkBatch:
    """Chunks of 9 steps of two episodes of 14, some of which hang over the ends."""
    buffer = EpisodeBuffer(history)
    generator = torch.Generator().manual_seed(2)
    buffer.add(
        [
            Episode(o, torch.randn(14, 2, generator=generator), torch.rand(14, generator=generator))
            for o in observations
        ]
    )
    batch = buffer.sample(6, 9, 4, generator)
    assert 0 < batch.window_weights.mean() < 1
    return batch


@pytest.mark.parametrize("seen", ["states", "frames"])
def test_plain_batches_have_the_losses_and_gradients_of_chunks(seen):
    torch.manual_seed(5)
    if seen == "states":
        observations, history, shape = torch.randn(2, 14, 3), 1, 3
    else:
        observations, history, shape = (
            torch.randint(0, 255, (2, 14, 64, 64, 3), dtype=torch.uint8),
            3,
            (64, 64, 3),
        )
    model = KoopmanModel(
        shape, 2, ModelConfig(2, 0.05, (6, 5), (4,), frame_features=3, frame_channels=(2, 2, 2))
    )
    batch = draw(observations, history)
    separate = separate_windows(batch, 4, history)
    assert separate.actions.shape == (6 * 5, 5, 2)
    results = []
    for chosen in (batch, separate):
        model.zero_grad()
        losses = chunk_losses(model, chosen, 4, 10.0)
        losses.total.backward()
        results.append((losses, [p.grad for p in model.parameters()]))
    (chunked, ours), (plain, theirs) = results
    torch.testing.assert_close(chunked.linear, plain.linear)
    torch.testing.assert_close(chunked.total, plain.total)
    for one, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-5 * float(one.abs().max()))


def test_updates_of_a_default_run_by_hand():
    # First 90 episodes of 185 windows: 83 batches of 200, 100 times. Then 110 episodes: 101 batches, 3 times; from
    # 130 episodes on the cap of 350, 15 times: up to 390 in steps of 20, and 400.
    assert updates_of_a_run(read_settings(), 200) == 8300 + 303 + 15 * 350


@pytest.mark.study
def test_it_prints_one_json_object(capsys):
    main(["--json", "--seconds", "0.1", "--only", "states"])
    result = json.loads(capsys.readouterr().out)["pendulum, states (P = 10, M = 1)"]
    assert result["plain_over_chunked"] > 1.0
    times = result["update_ms"]["chunked"]
    assert 0 < times["p10"] <= times["median"] <= times["p90"]
    parts = result["seed_seconds"]
    assert parts["total"] == pytest.approx(parts["updates"] + parts["environments"] + parts["planning"])


def test_times_that_are_no_times_are_refused(capsys):
    with pytest.raises(SystemExit):
        main(["--seconds", "0"])
    assert "--seconds 0" in capsys.readouterr().err
