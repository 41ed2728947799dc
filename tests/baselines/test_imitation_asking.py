"""Rules that choose questions, the ensemble's doubt, and which answer belongs to which question."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.config import BaselineConfigError
from baselines.imitation.asking import AboveThreshold, Always, AtRandom, Drawn, Seen, Threshold, novelty
from baselines.imitation.config import ImitationConfig
from baselines.imitation.ensemble import Ensemble
from baselines.imitation.learner import Labels, Learner
from baselines.imitation.questions import Answers, Label, OpenQuestions, Questions


def ensemble(members=3, size=2, hidden=(8,), low=(-2.0,), high=(2.0,)):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return Ensemble(size, np.array(low), np.array(high), members, hidden, 10.0)


def seen(scores, running=None):
    tensor = torch.as_tensor(scores, dtype=torch.float64)
    return Seen(
        torch.zeros(len(tensor), 2), tensor, np.ones(len(tensor), bool) if running is None else running
    )


def by_doubt(student, labels, shown):
    return shown.doubts


def test_doubt_and_action_by_hand():
    """Outputs 0.5, -0.5 and 3 are clipped to 0.5, -0.5 and 1: mean 1/3, variance (1/36 + 25/36 + 16/36) / 3 = 7/18."""
    student = ensemble(3, hidden=())
    with torch.no_grad():
        student.weights[0].zero_()
        student.biases[0][:, 0, 0] = torch.tensor([0.5, -0.5, 3.0])
    actions, doubts = student.decide(torch.zeros(1, 2))
    assert actions.item() == pytest.approx(2.0 / 3.0)  # half a range is 2
    assert doubts.item() == pytest.approx(math.sqrt(7.0 / 18.0))


def test_members_computed_as_one_are_those_computed_alone():
    student = ensemble(4, hidden=(8, 5))
    observations = torch.randn(6, 2, generator=torch.Generator().manual_seed(1))
    together = student(observations)
    for member in range(4):
        value = observations
        for layer in range(3):
            value = value @ student.weights[layer][member] + student.biases[layer][member]
            value = value if layer == 2 else torch.tanh(value)
        torch.testing.assert_close(together[member], value)


def test_actions_of_the_environment_come_back():
    student = ensemble(low=(-1.0, 0.0), high=(3.0, 10.0))
    units = student.to_unit(torch.tensor([[-1.0, 10.0], [1.0, 5.0], [9.0, -9.0]], dtype=torch.float64))
    assert units.tolist() == [[-1.0, 1.0], [0.0, 0.0], [1.0, -1.0]]


@settings(max_examples=30, deadline=None)
@given(st.floats(0.02, 0.3), st.floats(-3.0, 3.0), st.integers(0, 2**31))
def test_the_share_of_questions_comes_to_the_wanted_one_whatever_the_scale(rate, scale, seed):
    """Summed up, share - rate = log(h_n / h_0) / (g n): scores that fall by a factor 10 move it by 2.3 / (g n)."""
    rule = AboveThreshold(by_doubt, Threshold(rate, 0.1))
    generator, asked, steps = np.random.default_rng(seed), 0, 1500
    first = None
    for step in range(steps):
        falling = 10.0 ** (scale - step / steps)
        asked += (rule.choose(None, None, seen(falling * generator.exponential(size=4))) > 0).sum()
        first = first or rule.threshold.value
    share, moved = asked / (4 * steps), math.log(rule.threshold.value / first)
    assert share - rate == pytest.approx(moved / (0.1 * steps), abs=1e-3)
    assert share == pytest.approx(rate, abs=0.05)


def test_the_largest_scores_are_asked_about():
    rule = AboveThreshold(by_doubt, Threshold(0.1, 0.1))
    generator, scores, asked = np.random.default_rng(0), [], []
    for _ in range(800):
        scores.append(generator.uniform(size=4))
        asked.append(rule.choose(None, None, seen(scores[-1])))
    chosen = np.concatenate(asked[100:]) > 0
    assert np.concatenate(scores[100:])[chosen].min() > 0.7


def test_the_first_step_asks_nothing():
    rule = AboveThreshold(by_doubt, Threshold(0.1, 0.1))
    assert not rule.choose(None, None, seen([3.0, 5.0])).any()
    assert rule.choose(None, None, seen([3.0, 5.0])).tolist() == [0.0, 1.0]


def test_nothing_below_the_smallest_doubt_is_asked():
    rule = AboveThreshold(by_doubt, Threshold(0.5, 0.1, 0.2))
    for _ in range(200):
        assert not rule.choose(None, None, seen([0.1, 0.19])).any()
    assert rule.threshold.value == 0.2


def test_a_fixed_threshold_stays():
    rule = AboveThreshold(by_doubt, Threshold(0.5, 0.0, 0.2))
    assert rule.choose(None, None, seen([0.1, 0.3])).tolist() == [0.0, 1.0]
    assert rule.choose(None, None, seen([0.19, 0.21])).tolist() == [0.0, 1.0]


def test_drawn_questions_come_to_the_rate_and_grow_with_the_doubt():
    rule = Drawn(by_doubt, Threshold(0.1, 0.05), torch.Generator().manual_seed(0))
    asked = np.array([rule.choose(None, None, seen([1.0, 2.0, 3.0, 4.0])) for _ in range(4000)])
    share = asked[500:].mean(0)
    assert share.mean() == pytest.approx(0.1, abs=0.01)
    assert share == pytest.approx([0.04, 0.08, 0.12, 0.16], abs=0.02)


def test_weights_make_the_loss_that_of_all_visited_steps():
    """Steps of score 1 and 3, asked with p and 3 p: each has to weigh the same in the sum."""
    rule = Drawn(by_doubt, Threshold(0.1, 0.05), torch.Generator().manual_seed(0), 0.1)
    weights = np.array([rule.choose(None, None, seen([1.0, 3.0])) for _ in range(6000)])[500:]
    assert weights.mean(0) == pytest.approx([0.1, 0.1], rel=0.15)
    assert (weights[:, 0][weights[:, 0] > 0].mean()) > 2 * (weights[:, 1][weights[:, 1] > 0].mean())


def test_a_weight_counts_in_the_fit():
    """Two answers to one observation, 1 with the weight 3 and -1 with 1: the least squares are at 0.5."""
    config = ImitationConfig(members=2, hidden=(8,), updates=400, learning_rate=1e-2)
    learner = Learner(ensemble(2, low=(-1.0,), high=(1.0,)), config)
    answered = [Label(np.zeros(2), np.array([a]), w) for a, w in ((1.0, 3.0), (-1.0, 1.0))] * 200
    learner.add(answered, torch.Generator().manual_seed(0))
    learner.fit(torch.Generator().manual_seed(0))
    assert learner.ensemble(torch.zeros(1, 2)).flatten().tolist() == pytest.approx([0.5, 0.5], abs=0.1)


def test_environments_whose_episode_is_over_are_not_asked():
    running = np.array([True, False])
    student, labels = ensemble(), Labels(2, 1, 3)
    rules = [
        Always(),
        AtRandom(0.9, torch.Generator().manual_seed(0)),
        AboveThreshold(by_doubt, Threshold(0.5, 0.0)),
    ]
    for rule in rules:
        asked = [rule.choose(student, labels, seen([1.0, 9.0], running)) for _ in range(20)]
        assert np.any(asked, 0).tolist() == [True, False]


def test_novelty_is_the_distance_to_the_nearest_answered_observation():
    student = ensemble()
    learner = Learner(student, ImitationConfig(members=3, hidden=(8,)))
    shown = Seen(
        torch.tensor([[0.0, 0.0], [3.0, 4.0]], dtype=torch.float64), torch.zeros(2), np.ones(2, bool)
    )
    assert novelty(student, learner.labels, shown).tolist() == [1.0, 1.0]
    labels = Labels(2, 1, 3)
    one = torch.zeros(1, 2, dtype=torch.float64), torch.zeros(1, 1), torch.ones(1)
    labels.add(*one, torch.Generator().manual_seed(0))
    # Moments of mean 0 and variance 1: the scale is 1.
    assert novelty(student, labels, shown).tolist() == pytest.approx([0.0, 5.0], abs=1e-3)


def test_each_member_draws_its_own_bootstrap_with_mean_one():
    labels = Labels(2, 1, 5)
    many = torch.zeros(4000, 2, dtype=torch.float64), torch.zeros(4000, 1), torch.ones(4000)
    labels.add(*many, torch.Generator().manual_seed(0))
    assert labels.counts.mean(1).tolist() == pytest.approx([1.0] * 5, abs=0.06)
    assert (labels.counts == 0).float().mean().item() == pytest.approx(math.exp(-1.0), abs=0.02)
    assert not torch.equal(labels.counts[0], labels.counts[1])


def test_a_member_learns_only_from_its_own_bootstrap():
    config = ImitationConfig(members=2, hidden=(8,), updates=150, learning_rate=1e-2)
    learner = Learner(ensemble(2), config)
    learner.add([Label(np.zeros(2), np.ones(1), 1.0)] * 20, torch.Generator().manual_seed(0))
    learner.labels.counts[1] = 0.0
    before = [weight[1].clone() for weight in learner.ensemble.weights]
    learner.fit(torch.Generator().manual_seed(0))
    outputs = learner.ensemble(torch.zeros(1, 2)).flatten()
    assert outputs[0].item() == pytest.approx(0.5, abs=0.05)
    assert all(torch.equal(a, b[1]) for a, b in zip(before, learner.ensemble.weights, strict=True))


def test_members_doubt_away_from_what_was_answered():
    config = ImitationConfig(hidden=(32, 32), updates=400)
    student = ensemble(5, hidden=(32, 32))
    learner, generator = Learner(student, config), np.random.default_rng(0)
    observations = generator.normal(scale=0.3, size=(300, 2))
    answered = [Label(o, np.sin(3 * o[:1]), 1.0) for o in observations]
    learner.add(answered, torch.Generator().manual_seed(0))
    learner.fit(torch.Generator().manual_seed(0))
    near, far = (student.decide(torch.from_numpy(s * generator.normal(size=(200, 2))))[1] for s in (0.3, 3.0))
    assert far.mean() > 5 * near.mean()


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_answers_in_any_order_find_their_observations(data):
    waiting, generator = OpenQuestions(), np.random.default_rng(0)
    shown = {}
    for step in range(6):
        observations, asked = generator.normal(size=(3, 2)), generator.random(3) < 0.6
        waiting.put(Questions(step, asked, observations))
        shown |= {(int(i), step): observations[i] for i in np.flatnonzero(asked)}
    order = data.draw(st.permutations(list(shown)))
    known = len(order)
    order = [
        *order[: known // 2],
        (0, 99),
        *order[: known // 2],
    ]  # one that nobody asked, and all of them twice
    answers = Answers(
        np.array([i for i, _ in order]), np.array([s for _, s in order]),
        np.array([[10.0 * i + s] for i, s in order]),
    )  # fmt: skip
    found = waiting.join(answers)
    assert len(found) == known // 2
    for label, key in zip(found, order, strict=False):
        assert np.array_equal(label.observation, shown[key])
        assert label.action[0] == 10.0 * key[0] + key[1]
    assert waiting.clear() == known - known // 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rule": "sometimes"}, 'rule = "sometimes"; choose one of doubt'),
        ({"query_rate": 1.0}, "query_rate = 1.0; give a value between 0 and 1"),
        ({"rule": "fixed"}, "smallest_doubt = 0.0"),
        ({"answer_delay": (3, 1)}, r"answer_delay = \[3, 1\]"),
        ({"teacher": "keys"}, "a person answers one environment at a time"),
        ({"query_budget": 0}, "query_budget = 0"),
    ],
)
def test_a_wrong_setting_is_named(changes, message):
    with pytest.raises(BaselineConfigError, match=message):
        ImitationConfig(**changes).check()
