"""Sampling of chunks: which windows, how often, and with which data."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.agent.buffer import Episode, EpisodeBuffer, ReplayError


def numbered(length: int, number: int) -> Episode:
    """Observation = (episode, step), action = step + 0.5, cost = 100 episode + step."""
    step = torch.arange(length, dtype=torch.float32)
    return Episode(
        torch.stack((torch.full_like(step, number), step), -1), step[:, None] + 0.5, 100.0 * number + step
    )


def filled(lengths: list[int]) -> EpisodeBuffer:
    buffer = EpisodeBuffer()
    buffer.add([numbered(length, number) for number, length in enumerate(lengths)])
    return buffer


@settings(max_examples=25, deadline=None)
@given(lengths=st.lists(st.integers(1, 30), min_size=1, max_size=5), seed=st.integers(0, 999))
def test_valid_windows_are_consecutive_steps_of_one_episode(lengths, seed):
    buffer, horizon = filled(lengths), 3
    generator = torch.Generator().manual_seed(seed)
    if max(lengths) <= horizon:
        with pytest.raises(ReplayError, match="4 steps"):
            buffer.sample(4, 8, horizon, generator)
        return
    batch = buffer.sample(4, 8, horizon, generator)
    assert (batch.window_weights.sum(1) >= 1).all()
    for g, i in batch.window_weights.nonzero().tolist():
        episode, step = batch.observations[g, i : i + 4].unbind(-1)
        assert (episode == episode[0]).all()
        assert (step.diff() == 1).all()
        assert (batch.actions[g, i : i + 4, 0] == step + 0.5).all()
        assert (batch.costs[g, i : i + 4] == 100 * episode + step).all()


def test_every_window_is_equally_likely_also_at_the_ends():
    buffer = filled([12, 6, 3])  # 9 + 3 + 0 windows of 4 steps
    batch = buffer.sample(40000, 8, 3, torch.Generator().manual_seed(1))
    starts = batch.observations[:, :5][batch.window_weights.bool()]
    counts = torch.bincount((10 * starts[:, 0] + starts[:, 1]).long(), minlength=20)
    seen = counts[counts > 0].double()
    assert counts.nonzero().flatten().tolist() == [*range(9), 10, 11, 12]
    assert (seen / seen.mean() - 1).abs().max() < 0.05


def test_counts_windows_episodes_and_steps():
    buffer = filled([12, 6, 3])
    assert (buffer.windows(3), len(buffer), buffer.steps) == (12, 3, 21)


def test_an_empty_buffer_says_so():
    with pytest.raises(ReplayError, match="none of 0 episodes"):
        EpisodeBuffer().sample(1, 8, 3, torch.Generator())


def test_windows_at_a_stride_start_at_its_multiples_and_are_equally_likely():
    # Windows of 4 steps at stride 4: starts 0, 4, 8 of 12 steps; 0 of 6 steps (4 would need 8); none of 3 steps.
    buffer = filled([12, 6, 3])
    assert buffer.windows(3, 4) == 4
    batch = buffer.sample(20000, 4, 3, torch.Generator().manual_seed(1), stride=4)
    assert bool(batch.window_weights.all())
    assert (batch.observations[..., 1].diff(dim=1) == 1).all()
    starts = batch.observations[:, 0]
    counts = torch.bincount((20 * starts[:, 0] + starts[:, 1]).long())
    assert counts.nonzero().flatten().tolist() == [0, 4, 8, 20]
    seen = counts[counts > 0].double()
    assert (seen / seen.mean() - 1).abs().max() < 0.05
