"""What the last line of a training says: intervals by hand, verdicts, words."""

import numpy as np
import pytest

from deepkoco.agent.references.comparison import EDMDC, RANDOM, ZERO, Comparison


def test_differences_are_paired_by_start_state():
    # Start states differ by far more than controllers. Differences -1, -2, -3: mean -2, standard deviation 1,
    # t(0.975, 2) = 4.3027, half-width 4.3027 / sqrt(3) = 2.4841.
    comparison = Comparison(
        "own", {"own": np.array([0.0, 98.0, 997.0]), ZERO: np.array([1.0, 100.0, 1000.0])}
    )
    (reference,) = comparison.references
    assert reference.difference.mean == -2.0
    assert reference.difference.low == pytest.approx(-4.4841, abs=1e-4)
    assert reference.verdict == "no difference"


@pytest.mark.parametrize(
    ("shift", "verdict", "words"),
    [
        (5.0, "better", ": better"),
        (-5.0, "worse", ": WORSE than zero action"),
        (0.0, "no difference", ": NO DIFFERENCE from zero action"),
    ],
)
def test_the_verdict_follows_from_the_interval(shift, verdict, words):
    own = np.arange(10.0)
    comparison = Comparison("own", {"own": own, ZERO: own + shift + 0.1 * np.sin(9.0 * own)})
    assert [r.verdict for r in comparison.references] == [verdict]
    assert words in comparison.line


def test_the_line_names_costs_verdicts_what_is_left_out_and_what_to_try():
    costs = {"own": [14.0, 14.4], ZERO: [59.0, 59.0], RANDOM: [14.2, 14.3], EDMDC: [4.6, 4.6]}
    comparison = Comparison(
        "own", {name: np.array(c) for name, c in costs.items()}, {"PD": "it has no gains"}, ("this", "that")
    )
    assert comparison.line == (
        "final cost 14.2 [11.7, 16.7] over 2 start states; zero action 59.0, random episodes 14.2, "
        "EDMDc + planner 4.60: WORSE than EDMDc + planner, NO DIFFERENCE from random episodes, better than zero action"
        "; PD left out, it has no gains; try: this; or that"
    )


def test_a_controller_that_lets_the_task_diverge_is_worse_than_one_that_does_not():
    comparison = Comparison("own", {"own": np.full(4, np.nan), ZERO: np.ones(4)})
    assert comparison.named("worse") == [ZERO]
    assert Comparison("own", {"own": np.ones(4), ZERO: np.full(4, np.inf)}).named("better") == [ZERO]


def test_a_single_start_state_decides_nothing():
    comparison = Comparison("own", {"own": np.array([1.0]), ZERO: np.array([2.0])})
    assert comparison.named("no difference") == [ZERO]
    assert "final cost 1.00 over 1 start state;" in comparison.line


def test_one_diverged_start_state_does_not_hide_that_all_others_are_cheaper():
    own, other = np.arange(10.0), np.arange(10.0) + 1.0
    other[3] = np.inf
    assert Comparison("own", {"own": own, ZERO: other}).named("better") == [ZERO]
    assert Comparison("own", {"own": other, ZERO: own}).named("worse") == [ZERO]


def test_who_diverges_is_not_better_for_being_cheaper_elsewhere():
    own, other = np.arange(10.0), np.arange(10.0) + 1.0
    own[3] = np.nan
    assert Comparison("own", {"own": own, ZERO: other}).named("no difference") == [ZERO]


def test_controllers_that_diverge_alike_do_not_differ():
    costs = np.array([1.0, np.inf, 2.0])
    assert Comparison("own", {"own": costs, ZERO: costs}).named("no difference") == [ZERO]
