"""The replay of transitions against a plain list of them."""

from itertools import pairwise

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines import replay as module
from baselines.encoders import as_input
from baselines.replay import Replay

SHAPE = (4, 5, 3)


def fill(replay, shape, rounds, seed):
    """Episodes of the given lengths side by side; returns each transition as it should be read."""
    rng, expected = np.random.default_rng(seed), []
    images = len(shape) == 3

    def show(count):
        if images:
            return rng.integers(0, 256, (count, *shape)).astype(np.uint8)
        return rng.normal(size=(count, *shape)).astype(np.float32)

    for lengths in rounds:
        lengths = np.array(lengths)
        shown = show(len(lengths))
        stacks = [[o] * 3 for o in shown]
        replay.start(shown)
        for step in range(lengths.max()):
            running = step < lengths
            actions = rng.uniform(-1, 1, (len(lengths), 2)).astype(np.float32)
            rewards = rng.normal(size=len(lengths)).astype(np.float32)
            terminated = rng.random(len(lengths)) < 0.2
            following = show(len(lengths))
            replay.add(actions, rewards, terminated, following, running)
            for i in np.flatnonzero(running):
                after = [*stacks[i][1:], following[i]]
                seen = [np.concatenate(s, -1) if images else s[-1] for s in (stacks[i], after)]
                expected.append((seen[0], actions[i], rewards[i], float(not terminated[i]), seen[1]))
                stacks[i] = after
    return expected


def read(replay, number):
    """One transition by its number, through the draw."""

    class Fixed:
        pass

    original = torch.randint
    try:
        torch.randint = lambda *_, **__: torch.tensor([number])  # type: ignore[assignment]
        batch = replay.sample(1, torch.Generator())
    finally:
        torch.randint = original
    return batch


rounds = st.lists(st.lists(st.integers(1, 6), min_size=1, max_size=3), min_size=1, max_size=3)


@settings(max_examples=25, deadline=None)
@given(rounds, st.booleans(), st.integers(0, 99))
def test_transitions_are_read_as_they_were_added(rounds, images, seed):
    shape = SHAPE if images else (2,)
    replay = Replay(shape, 2, 3 if images else 1)
    expected = fill(replay, shape, rounds, seed)
    assert len(replay) == len(expected)
    for number, (o, a, r, c, following) in enumerate(expected):
        batch = read(replay, number)
        torch.testing.assert_close(batch.observations, as_input(torch.from_numpy(o)[None]))
        torch.testing.assert_close(batch.following, as_input(torch.from_numpy(following)[None]))
        np.testing.assert_array_equal(batch.actions[0].numpy(), a)
        assert batch.rewards.item() == r
        assert batch.continues.item() == c


def test_parts_make_the_same_replay():
    whole, copy = Replay(SHAPE, 2, 3), Replay(SHAPE, 2, 3)
    fill(whole, SHAPE, [[3, 5]], 0)
    copy.extend(whole.since(0, 0))
    rows, transitions = whole.rows, len(whole)
    fill(whole, SHAPE, [[4], [2, 2]], 1)
    part = whole.since(rows, transitions)
    assert len(part["rows"]) == whole.rows - rows
    copy.extend(part)
    g = [torch.Generator().manual_seed(0) for _ in range(2)]
    for name, tensor in vars(whole.sample(50, g[0])).items():
        assert torch.equal(tensor, getattr(copy.sample(50, g[1].manual_seed(0)), name))


def test_frames_are_stored_once():
    replay = Replay(SHAPE, 2, 3)
    fill(replay, SHAPE, [[7, 7]], 0)
    assert len(replay) == 14
    assert replay.rows == 2 * (7 + 1)


def test_tables_grow(monkeypatch):
    monkeypatch.setattr(module, "FIRST_ROWS", 2)
    replay = Replay((2,), 2)
    expected = fill(replay, (2,), [[9], [30]], 0)
    for number in (0, 8, 9, 38):
        assert read(replay, number).rewards.item() == expected[number][2]


def test_every_transition_is_equally_likely():
    replay = Replay((1,), 1)
    replay.start(np.zeros((1, 1), np.float32))
    for i in range(5):
        step = np.full((1, 1), i, np.float32)
        replay.add(step, step[0], np.zeros(1, bool), step, np.ones(1, bool))
    drawn = replay.sample(5000, torch.Generator().manual_seed(0)).rewards
    counts = torch.bincount(drawn.long(), minlength=5)
    # The standard deviation of a count is 28.
    assert (counts - 1000).abs().max() < 120


@settings(max_examples=25, deadline=None)
@given(rounds, st.integers(0, 99))
def test_transitions_are_put_together_to_their_episodes(rounds, seed):
    replay = Replay((2,), 2)
    expected = fill(replay, (2,), rounds, seed)
    episodes = replay.episodes(len(replay))
    assert [len(r) for _, _, r in episodes] == [length for lengths in rounds for length in lengths]
    following = {tuple(o): tuple(after) for o, _, _, _, after in expected}
    for observations, _, _ in episodes:
        rows = [tuple(row) for row in observations.numpy()]
        assert all(following[one] == other for one, other in pairwise(rows))
    cut = replay.episodes(1)
    assert len(cut) == 1
    assert cut[0][2].shape == (1,)
